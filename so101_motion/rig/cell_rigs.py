"""Open all arms of a cell file, and let them keep off each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from so101_motion.arm.cell import Cell, with_item
from so101_motion.arm.gripper import JAW_CLOSED
from so101_motion.common import interrupts
from so101_motion.common.clock import Clock
from so101_motion.common.encoder_zeros import EncoderZeros
from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.named_poses import POSES
from so101_motion.common.units import to_rad
from so101_motion.drivers.port.port_list import device_of
from so101_motion.files.cell_file import CellFile
from so101_motion.files.tool_file import find_tool
from so101_motion.planning.collision.apart import first_meeting
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.course import Course
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.hardware_rig import open_so101
from so101_motion.rig.rig import Rig
from so101_motion.rig.simulated_rig import open_simulated

ASIDE = tuple(to_rad(np.array([0.0, 45.0, 90.0])))
"""Pan angles that are tried for simulated arms that would touch [rad]; chosen."""

_PAN = np.array([1.0, 0.0, 0.0, 0.0, 0.0])


class CellRigs:
    """The arms of a cell, opened. Use it in a ``with`` block or call ``close``.

    Attributes:
        file: Where they stand.
        rigs: The rig of each arm by its name, in the order of the file.
        cell: Keeps them off each other. Items that one of them moves are so in all their scenes.
    """

    def __init__(self, file: CellFile, rigs: Mapping[str, Rig], closing: ExitStack) -> None:
        self.file, self.rigs = file, dict(rigs)
        self.cell, self._closing = Cell(), closing
        for arm in file.arms:
            rig = self.rigs[arm.name]
            if arm.tool:
                rig.arm.set_tool(find_tool(arm.tool))
            rig.arm.scene = file.scene_of(arm)
            self.cell.add(arm.name, rig, arm.T_cell_base)
        for name, rig in self.rigs.items():
            rig.arm.on_scene = partial(self._share, name, rig.arm.on_scene)

    def _share(
        self, name: str, then: Callable[[Scene, Scene], None] | None, before: Scene, now: Scene
    ) -> None:
        """Have what an arm has taken or put down so in the scenes of the others, too."""
        if then is not None:
            then(before, now)
        items, old = ({each.name: each for each in scene.items} for scene in (now, before))
        changed = [key for key in {**old, **items} if items.get(key) is not old.get(key)]
        members = self.cell.members
        for other, rig in self.rigs.items():
            T = members[other].T_cell_base.inverse @ members[name].T_cell_base
            scene = rig.arm.scene
            for key in changed if other != name else ():
                scene = with_item(scene, key, items.get(key), T)
            if scene is not rig.arm.scene:
                rig.arm.scene = scene

    def zeros(self) -> dict[str, EncoderZeros | None]:
        """The zeros of each arm's calibration, by the arm's name; None if not known."""
        return {name: rig.connection.encoder_zeros for name, rig in self.rigs.items()}

    @interrupts.held()
    def close(self) -> None:
        self._closing.close()

    def __enter__(self) -> CellRigs:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_cell(file: CellFile, *, clock: Clock | None = None) -> CellRigs:
    """Open the arms of a cell; opening moves nothing.

    Those without a port are simulated. They stand in the first named pose in which all of them keep
    apart, turned aside if need be.

    Args:
        file: As ``files.cell_file.read_cell`` reads it.
        clock: The clock of all rigs; the real time by default.

    Raises:
        ConfigError: A setting cannot be used, or two ports are names of one device.
        BusError: A port cannot be opened, or a servo does not answer; nothing stays open.
    """
    _refuse_one_device_twice(file)
    q_start = _free_pose(file)
    with ExitStack() as opened:
        rigs: dict[str, Rig] = {}
        for arm in file.arms:
            try:
                if arm.port:
                    rig: Rig = open_so101(arm.port, arm.calibration_id or None, clock=clock)
                else:
                    rig = open_simulated(clock=clock, q_start=q_start)
            except So101Error as error:
                raise error.about(arm.name) from error
            rigs[arm.name] = opened.enter_context(rig)
            if arm.max_speed is not None:
                rig.arm.set_ceiling(replace(rig.arm.ceiling, speed=arm.max_speed))
        made = CellRigs(file, rigs, opened.pop_all())
    return made


def _refuse_one_device_twice(file: CellFile) -> None:
    devices: dict[str, str] = {}
    for arm in file.arms:
        other = devices.setdefault(device_of(arm.port), arm.name) if arm.port else arm.name
        if other != arm.name:
            reason = f'is the port of "{other}" under another name; `so101 ports` lists them'
            raise ConfigError("port", arm.port, reason)


def _free_pose(file: CellFile) -> Array | None:
    """A configuration in which no simulated arm touches anything; None if none was found."""
    simulated = [arm for arm in file.arms if not arm.port]
    model = RobotModel.load()
    checks = [CollisionModel(model, file.scene_of(arm)) for arm in simulated]

    def is_free(q: Array) -> bool:
        course = Course.resting(q, JAW_CLOSED)
        return all(each.first_contact(q, JAW_CLOSED) is None for each in checks) and all(
            first_meeting(
                (bodies_of(a.attached), course),
                (bodies_of(b.attached), course),
                a.T_cell_base.inverse @ b.T_cell_base,
                since=0.0,
            )
            is None
            for a, b in combinations(simulated, 2)
        )

    turned = (pose.q + aside * _PAN for aside in ASIDE for pose in POSES)
    return next(filter(is_free, turned), None)
