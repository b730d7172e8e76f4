"""Let the arms of this process know each other's positions and planned motions.

An arm that reads the frame system adds all arms with a frame to a cell (``arm/cell.py``), and
removes those without one. Arms whose clocks differ, as those of simulated arms may, do not share
one; each is an obstacle for the other, where it stands.
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from typing import Protocol

from viam.proto.service.motion import Constraints

from so101_motion.arm.cell import Cell
from so101_motion.arm.cell_member import CellMember, RigWithExecutor
from so101_motion.arm.protocols import OtherArms
from so101_motion.common.clock import Clock, MonotonicClock
from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import FLOOR, LINKS, Attached
from so101_motion.viam.conversion.world_state import UniqueNames
from so101_motion.viam.surroundings.machine_view import Body, nearly

_STAYED = 1e-6  # a base that has moved by less has not moved [m]; that is rounding


class CellArm(Protocol):
    """An arm of this process, its rig, and the components that it does not plan around."""

    @property
    def rig(self) -> RigWithExecutor: ...
    @property
    def ignored(self) -> Collection[str]: ...


class MachineCell:
    """The cells of the arms of this process, which come and go. Any thread may call."""

    def __init__(self, arms: Mapping[str, CellArm]) -> None:
        self._arms, self._lock = arms, threading.Lock()
        self._cells: dict[object, Cell] = {}
        self._joined: dict[str, tuple[RigWithExecutor, CellMember]] = {}
        self._closed: set[str] = set()  # of these

    def meet(self, own: str, bases: Mapping[str, SE3]) -> frozenset[str]:
        """Take arms with a frame into a cell, others out; returns those that ``own`` keeps off."""
        with self._lock:
            for name in self._joined.keys() - bases.keys():
                self._leave(name)
            for name, T in bases.items():
                self._join(name, T)
            return self._joined[own][1].minded if own in self._joined else frozenset()

    def know(self, own: str, held: Mapping[str, tuple[Attached, ...]]) -> None:
        if (joined := self._joined.get(own)) is not None:
            joined[1].held = dict(held)

    def cell_of(self, name: str) -> Cell | None:
        return next((each for each in self._cells.values() if name in each.members), None)

    def leave(self, name: str, rig: RigWithExecutor) -> None:
        """Note that an arm is about to be closed.

        It stays where it stops, and the others keep off it until the machine is read again.
        """
        with self._lock:
            if name in self._joined and self._joined[name][0] is rig:
                self._closed.add(name)
                if self._closed == self._joined.keys():
                    for each in list(self._joined):
                        self._leave(each)

    def _join(self, name: str, T: SE3) -> None:
        arm = self._arms.get(name)
        if arm is None:
            return
        rig, member = self._joined.get(name, (None, None))
        if rig is arm.rig and member is not None:
            if not nearly(member.T_cell_base, T, _STAYED):
                member.T_cell_base = T
            return
        self._leave(name)
        cell = self._cells.setdefault(_time_of(arm.rig.clock), Cell())
        with suppress(So101Error):  # the arm is being closed
            self._joined[name] = arm.rig, cell.add(name, arm.rig, T, ignores=arm.ignored)

    def _leave(self, name: str) -> None:
        rig, _ = self._joined.pop(name, (None, None))
        self._closed.discard(name)
        if rig is not None:
            with suppress(So101Error):  # its control loop may have ended
                self._cells[_time_of(rig.clock)].remove(name, rig)
            self._cells = {key: each for key, each in self._cells.items() if each.members}


def held_by(bodies: Iterable[Body], arms: Collection[str]) -> dict[str, tuple[Attached, ...]]:
    held: dict[str, list[Attached]] = {name: [] for name in arms}
    names = UniqueNames({FLOOR, *LINKS})
    for body in bodies:
        if body.holder in held:
            thing = Attached(name=names.new(body.name), shape=body.shape, T_tool_object=body.T)
            held[body.holder].append(thing)
    return {name: tuple(things) for name, things in held.items()}


def refuse_through(member: OtherArms | None, constraints: Constraints) -> None:
    """Refuse a request that allows contact with an arm of the same cell."""
    for specification in constraints.collision_specification:
        for allow in specification.allows:
            for name in (allow.frame1, allow.frame2):
                if member is not None and name.partition(":")[0] in member.minded:
                    reason = (
                        "is an arm of this process, and contact with it cannot be allowed in a"
                        " request; to ignore it, name it in the other arm's"
                        ' "ignore_components"'
                    )
                    raise ConfigError("collision_specification", name, reason)


def _time_of(clock: Clock) -> object:
    return MonotonicClock if isinstance(clock, MonotonicClock) else clock
