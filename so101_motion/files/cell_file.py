"""Read and write ``cell.json``: arms that share a space, their bases and the obstacles around them.

Millimetres and degrees, with the unit in every name, in the frame of the cell; see
``docs/cell.md``. ``port`` may be left out for arms that are only simulated; the scene may be left
out, too. The objects an arm holds are listed in its entry, in its tool frame; ``tool`` names what
is fixed to its gripper, or its file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.common.attributes import SPEED_RANGE_DEG, Attributes
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.common.units import to_deg, to_mm, to_rad
from so101_motion.files import atomic, json_file
from so101_motion.files.scene_file import (
    attached_from,
    attached_to,
    pose_from,
    scene_from,
    scene_to,
)
from so101_motion.files.tool_file import find_tool
from so101_motion.planning.collision.scene import Attached, Scene
from so101_motion.planning.collision.shape_files import LARGEST_FILE

UPRIGHT = 1e-6  # largest lean of a base that still counts as upright [rad]; rounding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellArm:
    """One arm of a cell."""

    name: str  # its name in messages
    T_cell_base: SE3  # pose of its base in the cell
    port: str = ""  # its serial port; empty for one that is only simulated
    calibration_id: str = ""  # its id in LeRobot; empty to use the calibration stored in the servos
    attached: tuple[Attached, ...] = ()  # the objects it holds
    max_speed: float | None = None  # cap of its joints that nobody may raise [rad/s]
    tool: str = ""  # what is fixed to its gripper: a tool's name, or its file; empty for nothing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellFile:
    """The content of a cell file."""

    arms: tuple[CellArm, ...]  # the arms, at least one
    scene: Scene  # the obstacles around them, in the cell's frame

    def scene_of(self, arm: CellArm) -> Scene:
        """The scene in the base frame of an arm, which stands upright if there is a floor."""
        T_base_cell, floor_z = arm.T_cell_base.inverse, self.scene.floor_z
        if floor_z is not None:
            if np.abs(arm.T_cell_base.R[:, 2] - [0.0, 0.0, 1.0]).max() > UPRIGHT:
                reason = f'"{arm.name}" does not stand upright; give the scene "floor_z_mm": null'
                raise ConfigError("rpy_deg", to_deg(arm.T_cell_base.rpy).tolist(), reason)
            floor_z -= float(arm.T_cell_base.p[2])
        obstacles = tuple(
            replace(each, T_base_obstacle=T_base_cell @ each.T_base_obstacle)
            for each in self.scene.obstacles
        )
        return replace(self.scene, obstacles=obstacles, floor_z=floor_z, attached=arm.attached)

    def with_bases(self, bases: Mapping[str, SE3]) -> CellFile:
        """A copy with other base poses ``T_cell_base`` for some arms, by name."""
        arms = (
            replace(each, T_cell_base=bases.get(each.name, each.T_cell_base)) for each in self.arms
        )
        return replace(self, arms=tuple(arms))


_MAX_SPEED = "max_speed_degs_per_sec"
_MORE = ("tool", _MAX_SPEED)

APART = 0.35
"""Distance between the bases of neighbours in a circle [m]; chosen: they reach each other's tools
and do not touch when folded."""


def arms_in_a_circle(count: int) -> CellFile:
    """Two or more simulated arms that face the middle of a circle, for trying things out."""
    radius = 0.5 * APART / np.sin(np.pi / count)
    arms = []
    for k, angle in enumerate(2.0 * np.pi * np.arange(count) / count):
        # The first stands at the origin, the middle before it.
        p = radius * np.array([1.0 - np.cos(angle), -np.sin(angle), 0.0])
        T_cell_base = SE3.from_rpy((0.0, 0.0, float(angle)), p)
        arms.append(CellArm(name=f"arm {k + 1}", T_cell_base=T_cell_base))
    return CellFile(arms=tuple(arms), scene=Scene())


def read_cell(path: Path) -> CellFile:
    """Read a cell file; ``ConfigError`` names what cannot be read or is not valid."""
    content = json_file.read_setting("cell", path, LARGEST_FILE)
    if not isinstance(content, Mapping):
        raise ConfigError("cell", content, 'must be an object such as {"arms": [...]}')
    given = Attributes(content, ("arms", "scene"), kind="key of a cell")
    arms = tuple(_arm(entry, path.parent) for entry in given.objects("arms"))
    if not arms:
        raise ConfigError("arms", content.get("arms"), "must name at least one arm")
    _refuse_twice("name", [each.name for each in arms])
    _refuse_twice("port", [each.port for each in arms if each.port])
    scene = scene_from(content.get("scene", {}), folder=path.parent)
    if scene.attached:
        raise ConfigError("attached", scene.attached[0].name, "is held by an arm, not by a cell")
    return CellFile(arms=arms, scene=scene)


def write_cell(cell: CellFile, path: Path) -> None:
    """Write a cell file; ``ConfigError`` if it cannot be written."""
    _save({"arms": [_entry(each) for each in cell.arms], "scene": scene_to(cell.scene)}, path)


def add_arms(arms: Sequence[CellArm], path: Path) -> None:
    """Add arms to a valid cell file, which keeps all that it says; makes one if there is none."""
    if not path.exists():
        return write_cell(CellFile(arms=tuple(arms), scene=Scene()), path)
    content: Any = json_file.read_setting("cell", path, LARGEST_FILE)
    _save({**content, "arms": [*content["arms"], *map(_entry, arms)]}, path)


def _save(content: Mapping[str, object], path: Path) -> None:
    atomic.save("cell", path, (json.dumps(content, indent=2) + "\n").encode())


def _arm(entry: Mapping[str, object], folder: Path) -> CellArm:
    known = ("name", "port", "calibration_id", "position_mm", "rpy_deg", "attached", *_MORE)
    given = Attributes(entry, known, kind="key of an arm")
    name, (low, high) = given.text("name", ""), SPEED_RANGE_DEG
    if not name:
        raise ConfigError("name", name, "each arm needs a name: messages use it")
    tool = given.text("tool", "")
    if tool.endswith(".json"):
        tool = str(folder / tool)
    if tool:
        find_tool(tool)  # refuses what is not valid
    return CellArm(
        name=name,
        tool=tool,
        T_cell_base=pose_from(given),
        port=given.text("port", ""),
        calibration_id=given.text("calibration_id", ""),
        attached=attached_from(entry.get("attached", []), folder=folder),
        max_speed=to_rad(given.required(_MAX_SPEED, lower=low, upper=high, unit="deg/s"))
        if given.given(_MAX_SPEED)
        else None,
    )


def _refuse_twice(key: str, values: Sequence[str]) -> None:
    for value in values:
        if values.count(value) > 1:
            raise ConfigError(key, value, "is used twice; each arm needs its own")


def _entry(arm: CellArm) -> dict[str, object]:
    entry: dict[str, object] = {"name": arm.name}
    for key in ("port", "calibration_id", "tool"):
        if getattr(arm, key):
            entry[key] = getattr(arm, key)
    entry["position_mm"] = [round(float(each), 3) for each in to_mm(arm.T_cell_base.p)]
    entry["rpy_deg"] = [round(float(each), 4) for each in to_deg(arm.T_cell_base.rpy)]
    if arm.max_speed is not None:
        entry[_MAX_SPEED] = round(to_deg(arm.max_speed), 6)
    if arm.attached:
        entry["attached"] = attached_to(arm.attached)
    return entry
