"""Read a tool: what is fixed to the gripper for good, such as a camera on its mount.

A tool is one of the presets of the robot description (``TOOLS``), a JSON file, or the same as an
object; see ``docs/tools.md``.

Everything is in the tool frame. Without ``tcp`` the tool's point is that between the jaws. Parts
are entries like ``attached`` in a scene file; each has its centre of mass at its origin.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import so101_description

from so101_motion.common.attributes import Attributes, suggest
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.files import json_file
from so101_motion.files.scene_file import attached_from, pose_from
from so101_motion.planning.collision.scene import TCP_FRAME, Tool
from so101_motion.planning.collision.shape_files import LARGEST_FILE


@cache
def presets() -> Mapping[str, Mapping[str, object]]:
    """The tools of the robot description by name, each with the origin of its figures."""
    found: dict[str, dict[str, object]] = json.loads(so101_description.TOOLS_PATH.read_text())
    return found


def find_tool(which: object) -> Tool:
    """The tool that a name, the path of a ``.json`` file, or an object describes.

    Raises:
        ConfigError: There is none, or what is not valid in it.
    """
    if isinstance(which, Mapping):
        return tool_from(which)
    if not isinstance(which, str):
        raise ConfigError("tool", which, "must be a name, a .json file, or an object with parts")
    if which in presets():
        return tool_from({"name": which, **presets()[which]})
    path = Path(which)
    if path.suffix != ".json":
        raise ConfigError(
            "tool", which, f"is no tool and no .json file; {suggest(which, presets())}"
        )
    content = json_file.read_setting("tool", path, LARGEST_FILE)
    if not isinstance(content, Mapping):
        raise ConfigError("tool", str(path), "must hold an object with parts")
    return tool_from({"name": path.stem, **content}, path.parent)


def tool_from(content: Mapping[str, object], folder: Path = Path()) -> Tool:
    """Make a tool from parsed JSON; mesh files are looked for in ``folder``."""
    given = Attributes(content, ("name", "tcp", "frames", "parts", "source"), kind="key of a tool")
    frames = content.get("frames", {})
    if not isinstance(frames, Mapping):
        raise ConfigError("frames", frames, "must be an object of poses by name")
    between_jaws = {"position_mm": [1e3 * x for x in so101_description.ROBOT.tcp]}
    poses = {**frames, TCP_FRAME: content.get("tcp", between_jaws)}
    parts = attached_from(content.get("parts", []), folder=folder)
    return Tool(
        name=given.text("name", "tool"),
        parts=tuple(replace(part, fixed=True) for part in parts),
        frames={name: _pose(name, pose) for name, pose in poses.items()},
        source=given.text("source", ""),
    )


def _pose(name: str, value: object) -> SE3:
    if not isinstance(value, Mapping):
        raise ConfigError(name, value, 'must be a pose such as {"position_mm": [0, 0, 120]}')
    return pose_from(Attributes(value, ("position_mm", "rpy_deg"), kind=f"key of {name}"))
