"""Arms of this process that have a frame know each other: where they are, and what they will do.

The frame system says where their bases stand. Who has read it takes all arms with a frame into a
cell (``arm/cell.py``), itself among them, and those out of it that have lost theirs. Arms whose
clocks show different times, as simulated ones may, are no company for each other; they are planned
around where they stand.
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from typing import Protocol

from viam.proto.service.motion import Constraints

from so101_motion.arm.cell import Cell
from so101_motion.arm.place import Place, RigWithExecutor
from so101_motion.common.clock import Clock, MonotonicClock
from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import FLOOR, LINKS, Attached
from so101_motion.viam.conversion.world_state import UniqueNames
from so101_motion.viam.surroundings.machine_view import Body, nearly

_STAYED = 1e-6
"""A base that has moved by less stands where it stood [m]: rounding, no more."""


class CellArm(Protocol):
    """An arm of this process with what moves it."""

    @property
    def rig(self) -> RigWithExecutor:
        """What moves it."""

    @property
    def ignored(self) -> Collection[str]:
        """Names of components that it does not keep off."""


class MachineCell:
    """The cells of the arms of this process. Any thread may call.

    Args:
        arms: The arms by name, as they come and go.
    """

    def __init__(self, arms: Mapping[str, CellArm]) -> None:
        self._arms, self._lock = arms, threading.Lock()
        self._cells: dict[object, Cell] = {}
        self._joined: dict[str, RigWithExecutor] = {}
        self._closed: set[str] = set()  # of these

    def meet(self, own: str, bases: Mapping[str, SE3]) -> frozenset[str]:
        """Let arms know each other.

        Args:
            own: The arm that asks.
            bases: Where the base of each arm stands that has a frame.

        Returns:
            The arms whose motions ``own`` knows and minds.
        """
        with self._lock:
            for name in self._joined.keys() - bases.keys():
                self._leave(name)
            for name, T in bases.items():
                self._join(name, T)
            place = self._joined[own].arm.place if own in self._joined else None
            return frozenset() if place is None else place.minded

    def know(self, own: str, held: Mapping[str, tuple[Attached, ...]]) -> None:
        """What arms hold, by their names, as one of them has read it."""
        joined = self._joined.get(own)
        if joined is not None and joined.arm.place is not None:
            joined.arm.place.held = dict(held)

    def leave(self, name: str, rig: RigWithExecutor) -> None:
        """An arm is about to be closed; may be called for one that has not joined.

        It stands where it stops, and what the others are doing goes on. So they keep off it until
        the machine has been read again, unless there are no others.
        """
        with self._lock:
            if self._joined.get(name) is rig:
                self._closed.add(name)
                if self._closed == self._joined.keys():
                    for each in list(self._joined):
                        self._leave(each)

    def _join(self, name: str, T: SE3) -> None:
        arm = self._arms.get(name)
        if arm is None:
            return
        joined, place = self._joined.get(name), arm.rig.arm.place
        if joined is arm.rig and place is not None:
            if not nearly(place.T_cell_base, T, _STAYED):
                place.T_cell_base = T
            return
        self._leave(name)
        cell = self._cells.setdefault(_time_of(arm.rig.clock), Cell())
        with suppress(So101Error):  # one that is being closed stands where it is
            cell.add(name, arm.rig, T, ignores=arm.ignored)
            self._joined[name] = arm.rig

    def _leave(self, name: str) -> None:
        rig = self._joined.pop(name, None)
        self._closed.discard(name)
        if rig is not None:
            with suppress(So101Error):  # its control loop may have ended
                self._cells[_time_of(rig.clock)].remove(name, rig)
            self._cells = {key: each for key, each in self._cells.items() if each.places}


def held_by(bodies: Iterable[Body], arms: Collection[str]) -> dict[str, tuple[Attached, ...]]:
    """What of some bodies each arm holds, by the arm's name."""
    held: dict[str, list[Attached]] = {name: [] for name in arms}
    names = UniqueNames({FLOOR, *LINKS})
    for body in bodies:
        if body.holder in held:
            thing = Attached(name=names.new(body.name), shape=body.shape, T_tool_object=body.T)
            held[body.holder].append(thing)
    return {name: tuple(things) for name, things in held.items()}


def refuse_through(place: Place | None, constraints: Constraints) -> None:
    """Refuse to except another arm whose motions are known.

    Raises:
        ConfigError: A pair of frames that may touch names one.
    """
    for specification in constraints.collision_specification:
        for allow in specification.allows:
            for name in (allow.frame1, allow.frame2):
                if place is not None and name.partition(":")[0] in place.minded:
                    reason = (
                        "is an arm of this process, and never gone through; an arm that shall not"
                        ' keep off it names it in its "ignore_components"'
                    )
                    raise ConfigError("collision_specification", name, reason)


def _time_of(clock: Clock) -> object:
    return MonotonicClock if isinstance(clock, MonotonicClock) else clock
