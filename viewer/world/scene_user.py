"""Who plans with the scene that the World tab edits: one arm, or several that share a space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.files.cell_file import CellFile, write_cell
from so101_motion.files.scene_file import write_scene
from so101_motion.planning.collision.scene import Attached, Scene
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig
from so101_motion.viam.client import MachineRig


class OneArm:
    """A single arm; the scene is in its base frame. Another program may change its scene, too."""

    def __init__(self, rig: RigLike) -> None:
        self._arm = rig.arm
        self.arms = {"": rig.arm}
        # What a machine of Viam calls the arm in whose frame the scene is; None for no arm.
        self.viam_name = rig.arm_name if isinstance(rig, MachineRig) else "arm"

    @property
    def scene(self) -> Scene:
        return self._arm.scene

    def tools(self) -> dict[str, SE3]:
        return {"": self._arm.T_base()}

    def use(self, scene: Scene) -> None:
        self._arm.scene = scene

    write = staticmethod(write_scene)


class ArmsOfCell:
    """Arms that share a space; the scene is in the frame of the cell.

    What is held has its ``holder`` there. A handover may pass it on meanwhile.
    """

    viam_name = None

    def __init__(self, rigs: Mapping[str, Rig], file: CellFile) -> None:
        self._file, self._scene = file, file.scene
        self._seen: dict[str, Scene] = {}  # the arms' scenes, as they are in that one
        self.arms = {name: rig.arm for name, rig in rigs.items()}

    @property
    def scene(self) -> Scene:
        seen = {name: arm.scene for name, arm in self.arms.items()}
        if any(each is not self._seen.get(name) for name, each in seen.items()):
            held = {
                each.name: replace(each, holder=name)
                for name, scene in seen.items()
                for each in scene.attached
            }
            first = self._file.arms[0]
            around = tuple(
                replace(each, T_base_obstacle=first.T_cell_base @ each.T_base_obstacle)
                for each in seen[first.name].obstacles
            )
            self._seen = seen
            self._scene = replace(self._file.scene, obstacles=around, attached=tuple(held.values()))
        return self._scene

    def tools(self) -> dict[str, SE3]:
        """Where the gripper of each arm is now in the cell, by the arm's name."""
        bases = {each.name: each.T_cell_base for each in self._file.arms}
        return {name: bases[name] @ arm.T_base() for name, arm in self.arms.items()}

    def use(self, scene: Scene) -> None:
        """Let all arms plan with ``scene`` from now on, and hold what it says, or none of them.

        ``ConfigError`` if it does not say which arm holds something, or tilts an arm's floor.
        """
        file = self._file_with(scene)
        seen = {each.name: file.scene_of(each) for each in file.arms}
        for name, arm in self.arms.items():
            arm.scene = seen[name]
        self._file, self._scene = file, scene
        self._seen = {name: arm.scene for name, arm in self.arms.items()}

    def write(self, scene: Scene, file: Path) -> None:
        write_cell(self._file_with(scene), file)

    def _file_with(self, scene: Scene) -> CellFile:
        held: dict[str, list[Attached]] = {name: [] for name in self.arms}
        for each in scene.attached:
            if each.fixed:  # a part of a tool
                continue
            if each.holder not in held:
                reason = "is held, but the file does not say by which arm; attach it on this page"
                raise ConfigError("attached", each.name, reason)
            held[each.holder].append(replace(each, holder=""))
        names = {each.name for each in scene.attached}
        around = replace(
            scene,
            attached=(),
            may_touch=frozenset(pair for pair in scene.may_touch if not pair & names),
        )
        arms = (replace(each, attached=tuple(held[each.name])) for each in self._file.arms)
        return replace(self._file, scene=around, arms=tuple(arms))


SceneUser = OneArm | ArmsOfCell
"""Plans with the edited scene. ``arms`` are by name; it is empty where there is only one."""
