"""Who plans with the scene that the World tab edits: one arm, or several that share a space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from so101_motion.arm.arm import Arm
from so101_motion.common.errors import ConfigError
from so101_motion.files.cell_file import CellFile, write_cell
from so101_motion.files.scene_file import write_scene
from so101_motion.planning.collision.scene import Scene
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig
from so101_motion.viam.client import MachineRig


class SceneUser(Protocol):
    """Plans with an edited scene."""

    @property
    def scene(self) -> Scene:
        """The scene that is planned with."""

    @property
    def arms(self) -> Mapping[str, Arm]:
        """The arms by their names; the name is empty where there is only one."""

    @property
    def holder(self) -> Arm | None:
        """The arm whose gripper can be given things to hold, if that is clear."""

    @property
    def viam_name(self) -> str | None:
        """What a machine of Viam calls the arm in whose frame the scene is; None for no arm."""

    def use(self, scene: Scene) -> None:
        """Plan with ``scene`` from now on; ``ConfigError`` if that is not possible."""

    def write(self, scene: Scene, file: Path) -> None:
        """Write ``scene`` to a file; ``ConfigError`` if that fails."""


class OneArm:
    """A single arm; the scene is in its base frame. Another program may change its scene, too."""

    def __init__(self, rig: RigLike) -> None:
        self._arm = self.holder = rig.arm
        self.arms = {"": rig.arm}
        self.viam_name = rig.arm_name if isinstance(rig, MachineRig) else "arm"

    @property
    def scene(self) -> Scene:
        """The arm's scene."""
        return self._arm.scene

    def use(self, scene: Scene) -> None:
        """Plan with ``scene`` from now on."""
        self._arm.scene = scene

    def write(self, scene: Scene, file: Path) -> None:
        """Write a scene file."""
        write_scene(scene, file)


class ArmsOfCell:
    """Arms that share a space; the scene is in the frame of the cell, and what they hold stays.

    Args:
        rigs: Their rigs, by the names of the arms.
        file: Where they stand, and the first scene.
    """

    holder = viam_name = None

    def __init__(self, rigs: Mapping[str, Rig], file: CellFile) -> None:
        self._file = file
        self.arms = {name: rig.arm for name, rig in rigs.items()}

    @property
    def scene(self) -> Scene:
        """What is around all arms."""
        return self._file.scene

    def use(self, scene: Scene) -> None:
        """Let all arms plan with ``scene`` from now on.

        Raises:
            ConfigError: Something in it is held, or it has a floor on which an arm does not stand
                upright; then no arm has it.
        """
        if scene.attached:
            reason = "is held by a gripper; on this page no arm is given anything to hold"
            raise ConfigError("attached", scene.attached[0].name, reason)
        file = replace(self._file, scene=scene)
        seen = {each.name: file.scene_of(each) for each in file.arms}
        for name, arm in self.arms.items():
            arm.scene = replace(seen[name], attached=arm.scene.attached)
        self._file = file

    def write(self, scene: Scene, file: Path) -> None:
        """Write a cell file with these arms."""
        write_cell(replace(self._file, scene=scene), file)
