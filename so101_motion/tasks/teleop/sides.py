"""The two sides of a teleoperation: the interfaces, and arms of this process."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from so101_motion.arm.arm import SCENE
from so101_motion.arm.gripper import Gripper, JawFollowing
from so101_motion.calib.record.zero import MIDDLE
from so101_motion.common.attributes import checked_kind
from so101_motion.common.errors import Interrupted, NotHolding, So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT, JointReading, JointState
from so101_motion.control.executor import Channel, Executor
from so101_motion.control.following import Following
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.rig import Rig
from so101_motion.tasks.teleop.pilot import Pilot
from so101_motion.tasks.teleop.predictor import Predictor

_PLACE = {joint: i for i, joint in enumerate((*ARM_JOINTS, GRIPPER_JOINT))}

JAW_APPROACH = 0.2  # share of the jaw's speed until it is near the leader's; chosen
FRESH = 0.05  # an arm answers if its last snapshot is not older than this [s]; chosen, some periods


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SideState:
    """The joints of a side, and what it does."""

    x: Array  # joint angles [rad], and the aperture of the jaw, 0 to 1, shape (6,)
    x_goal: Array  # their setpoints, likewise; the measured values where nothing is driven
    loads: Sequence[float] = ()  # of each servo, -1 to 1 of full drive; empty where not known
    needs_recovery: bool = False  # whether there is work to do that takes a moment; see ``recover``
    is_limp: bool = False  # whether it can be moved by hand
    is_there: bool = True  # whether it answers
    is_engaged: bool = False  # whether it follows the pilot
    held_by: tuple[str, ...] = ()  # what is in its way, as far as it knows
    is_gripping: bool = False  # whether the jaw has closed on something, as far as it knows


class Side(ABC):
    """An arm of a teleoperation. Its methods may block."""

    @abstractmethod
    def detach(self) -> None:
        """End it and hold; a leader that was released is held again."""

    def recover(self) -> None:  # noqa: B027  # most sides need none
        """Do what ``state.needs_recovery`` announces; raises ``So101Error`` if it fails."""

    @property
    @abstractmethod
    def state(self) -> SideState:
        """Its state; never waits."""


class Leader(Side):
    """The side that is guided by hand."""

    @abstractmethod
    def attach(self, predictor: Predictor) -> None:
        """Release the joints and pass every measurement to ``predictor`` from now on."""


class Follower(Side):
    """The side that follows."""

    @abstractmethod
    def attach(self, pilot: Pilot, look: Callable[[], None]) -> None:
        """Set the pilot, and call ``look`` in every period until detached."""

    @abstractmethod
    def engage(self) -> None:
        """Start to follow the pilot; raises ``So101Error`` if it cannot."""

    @abstractmethod
    def ending(self) -> BaseException | None:
        """Why it stopped following, reported once; None while it follows."""


def jaw_of(rig: Rig) -> Gripper | None:
    """The gripper of a rig; None for an arm without its sixth servo."""
    if isinstance(rig, HardwareRig) and GRIPPER_JOINT not in rig.servos.setups:
        return None
    return rig.gripper


def middles_of(rig: Rig) -> Array:
    """The arm's angles in the middle of its joints' recorded travels, shape (5,), [rad]."""
    checked_kind("rig", rig, Rig, "what so101.open returns, of an arm on this computer")
    if not isinstance(rig, HardwareRig):
        return np.zeros(5)
    setups = rig.servos.setups
    zeros = [setups[joint].zero if joint in setups else MIDDLE for joint in ARM_JOINTS]
    return np.array([zero.angle for zero in zeros])


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalArm:
    """An arm of this process as one side; raises ``NotReady`` until its servos have been found."""

    station: Rig  # the arm
    jaw: Rig | None = None  # its gripper, perhaps of another rig; None to leave it alone

    def __post_init__(self) -> None:
        for part in (self.station, self.jaw):
            if isinstance(part, HardwareRig):
                part.require_ready()
        if self.jaw is not None and jaw_of(self.jaw) is None:
            object.__setattr__(self, "jaw", None)

    @property
    def executors(self) -> tuple[Executor, ...]:
        both = [self.station.executor, *([self.jaw.executor] if self.jaw else [])]
        return tuple(dict.fromkeys(both))

    def state(self, **facts: Any) -> SideState:
        """The state of its joints, with further facts."""
        rig, state = self.station, self.station.executor.state
        loads = rig.servos.health if isinstance(rig, HardwareRig) else ()
        aperture = goal = 0.0
        if self.jaw is not None:
            jaw = self.jaw.gripper
            aperture, span = jaw.aperture, jaw.opened - jaw.closed
            goal = (self.jaw.executor.state.q_jaw_ref - jaw.closed) / span
        return SideState(
            x=np.append(state.q, aperture),
            x_goal=np.append(state.q_ref, goal),
            loads=[joint.load for joint in loads],
            **facts,
        )


class LocalLeader(Leader):
    """An arm of this process as leader; with ``lets_go`` limp while it leads, then held."""

    def __init__(self, arm: LocalArm, *, lets_go: bool = True) -> None:
        self._arm, self._lets_go = arm, lets_go
        self._reading: JointReading | None = None  # the latest
        self._ends: list[Callable[[], None]] = []

    def attach(self, predictor: Predictor) -> None:
        if self._lets_go:
            self._arm.station.arm.stop()
            for executor in self._arm.executors:
                executor.stop(Channel.JAW).result()
                executor.release().result()
        self._ends.append(self._arm.station.executor.listen(partial(self._hear, predictor)))
        if self._arm.jaw is not None and len(self._arm.executors) > 1:
            self._ends.append(self._arm.jaw.executor.listen(lambda _: None))  # to be kept fresh

    def detach(self) -> None:
        for end in self._ends:
            end()
        self._ends.clear()
        if self._lets_go:
            for executor in self._arm.executors:
                executor.hold().result()

    def recover(self) -> None:
        """See ``Side.recover``: after a fault the joints are released again."""
        for executor in self._arm.executors:
            executor.release().result()

    @property
    def state(self) -> SideState:
        now, states = self._arm.station.clock.now(), [each.state for each in self._arm.executors]
        return self._arm.state(
            needs_recovery=self._lets_go
            and any(each.mode is Mode.FAULT and now - each.t < FRESH for each in states),
            is_limp=all(each.mode is Mode.LIMP for each in states),
        )

    def _hear(self, predictor: Predictor, state: JointState) -> None:
        is_old, self._reading = state.reading is self._reading, state.reading
        if is_old or state.mode is Mode.CALIBRATING:  # out of reach, or its angles mean nothing
            predictor.lose()
            return
        jaw = self._arm.jaw
        aperture = jaw.gripper.aperture if jaw is not None else 0.0
        heard = np.ones(6, dtype=bool)
        for joint in state.reading.unanswered:
            heard[_PLACE[joint]] = False
        heard[5] &= jaw is not None
        predictor.take(state.t, np.append(state.q, aperture), heard)


class LocalFollower(Follower):
    """An arm of this process as follower; if guarded it keeps clear of itself and its scene."""

    def __init__(self, arm: LocalArm, *, guarded: bool = True) -> None:
        self._arm, self._guarded = arm, guarded
        self._pilot: Pilot | None = None
        self._following: Following | None = None
        self._jaw: JawFollowing | None = None
        self._end: Callable[[], None] | None = None
        self._stops = 0

    def attach(self, pilot: Pilot, look: Callable[[], None]) -> None:
        pilot.fit(*self._arm.station.arm.range)
        self._pilot, self._stops = pilot, self._arm.station.arm.stops

        def each(_: JointState) -> None:
            self._lead_jaw(pilot)
            look()

        self._end = self._arm.station.executor.listen(each)

    def engage(self) -> None:
        pilot, arm = self._pilot, self._arm.station.arm
        assert pilot is not None, "attach it first"
        for executor in self._arm.executors:
            if executor.state.mode in (Mode.LIMP, Mode.GUIDING, Mode.FAULT):
                executor.hold().result()
        self._following = arm.follow(
            limits=pilot.pace.full,
            guard=SCENE if self._guarded else None,
            approach=pilot.pace.approach,
            each=partial(self._lead, pilot),
        )
        if self._jaw is None or self._jaw.future.done():
            self.recover()
        else:
            self._jaw.regrip()

    def detach(self) -> None:
        if self._end is not None:
            self._end()
        followings, self._following, self._jaw = (self._following, self._jaw), None, None
        for each in followings:
            if each is not None:
                each.close().exception()

    def ending(self) -> BaseException | None:
        """See ``Follower.ending``; a stop also counts while the follower waits at rest."""
        following = self._following
        if self._arm.station.arm.stops != self._stops:
            return Interrupted("stop")
        if following is None or not following.future.done():
            return None
        self._following = None
        return following.future.exception()

    def recover(self) -> None:
        """See ``Side.recover``: the jaw follows again."""
        jaw = self._arm.jaw
        if jaw is None:
            return
        if jaw.executor.state.mode in (Mode.LIMP, Mode.FAULT):
            raise NotHolding("the follower's jaw is limp; let it hold first (set_torque)")
        limits = jaw.gripper.limits
        slow = limits.lowered_to(JAW_APPROACH * limits.velocity, limits.acceleration)
        self._jaw = jaw.gripper.follow(approach=slow)

    @property
    def state(self) -> SideState:
        station, following, jaw = self._arm.station, self._following, self._jaw
        now, state = station.clock.now(), station.executor.state
        has_lost_jaw = self._arm.jaw is not None and (jaw is None or jaw.future.done())
        return self._arm.state(
            needs_recovery=following is not None and has_lost_jaw,
            is_there=now - state.t < FRESH
            and not state.reading.unanswered
            and state.mode is not Mode.CALIBRATING,
            is_engaged=following is not None,
            held_by=following.held_by if following is not None and following.is_held else (),
            is_gripping=jaw is not None and jaw.is_gripping,
        )

    # The I/O threads

    def _lead(self, pilot: Pilot, following: Following) -> None:
        wanted = pilot.arm(following.now.q)
        if wanted is None:
            following.hold(briefly=pilot.gate.pauses_mirroring)
        else:
            following.aim(*wanted, most=math.inf)  # a leader may turn on and on

    def _lead_jaw(self, pilot: Pilot) -> None:
        jaw = self._jaw
        if jaw is None or jaw.future.done():
            return
        wanted = pilot.jaw()
        if wanted is None:
            jaw.hold(briefly=pilot.gate.pauses_mirroring)
            return
        with suppress(So101Error):  # it has just ended
            jaw.aim(*wanted, most=math.inf)
