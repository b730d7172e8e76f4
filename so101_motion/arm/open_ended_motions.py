"""Make the followings, streams and jogs of an arm, and the collision guard that most share."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, Unpack

from so101_motion.arm.joint_caps import JointRange
from so101_motion.common.units import to_rad
from so101_motion.control.cartesian_jog import Jog
from so101_motion.control.following import Following, FollowingSettings
from so101_motion.control.joint_group import Channel
from so101_motion.control.streamed_trajectory import Stream
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.differential.guard import Guard
from so101_motion.planning.differential.servo import Servo
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Load, Payload, Strength, carried

if TYPE_CHECKING:
    from so101_motion.arm.protocols import ArmExecutor
    from so101_motion.common.geometry import Array
    from so101_motion.planning.collision.course import Neighbours
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.planning.kinematics.model import RobotModel

GUARDED_STOP = MotionLimits.uniform(velocity=to_rad(180.0), acceleration=to_rad(380.0), jerk=60.0)
"""Caps of a guarded stop. The emulated servos, fitted on recordings of one real servo, do not keep
to a harder one: with 600 deg/s^2 and 200 rad/s^3, to and fro at 180 deg/s, joints swung 8 deg past
their command and into the floor. Chosen by that measurement."""


class Situation(NamedTuple):
    """The surroundings, range and load that a motion must respect."""

    scene: Scene
    range: JointRange
    payload: Payload | None
    strength: Strength

    def load(self, model: RobotModel, q: Array) -> Load:
        """The load on the servos, for an arm at ``q``, shape (5,), [rad]."""
        return Load.of(model, self.strength, q, carried(self.payload, self.scene.attached))

    def is_same(self, other: Situation) -> bool:
        return all(mine is theirs for mine, theirs in zip(self, other, strict=True))


class OpenEndedMotions:
    """Makes the followings, streams and jogs of one arm.

    Followings, streams and hand guiding share a guard: only the I/O thread uses it, for one of them
    at a time. Making it takes some hundredths of a second, so other threads do that.

    Attributes:
        neighbours: Other arms to keep away from; None if there are none.
    """

    def __init__(self, model: RobotModel, executor: ArmExecutor) -> None:
        self.model, self._executor = model, executor
        self._lock = threading.Lock()
        self._made: tuple[Situation, Guard] | None = None
        # Of those that are guarded.
        self._newest: Following | Stream | Jog | GuidingWall | None = None
        self.neighbours: Neighbours | None = None

    def has_guard(self, now: Situation) -> bool:
        """Whether a guarded following for this situation can be made without waiting."""
        made = self._made
        return made is not None and made[0].is_same(now)

    def following(
        self,
        now: Situation,
        limits: MotionLimits,
        *,
        guarded: bool,
        share: Callable[[], float],
        **how: Unpack[FollowingSettings],
    ) -> Following:
        """A following from the arm's present setpoint."""
        executor = self._executor
        lower, upper = now.range
        following = Following(
            q_start=executor.state.q_ref,
            lower=lower,
            upper=upper,
            limits=limits,
            stop_limits=GUARDED_STOP if guarded else executor.stop_limits(Channel.ARM),
            dt=executor.dt,
            guard=self._guard(now) if guarded else None,
            neighbours=self.neighbours,
            share=share,
            **how,
        )
        if guarded:
            self._newest = following
        return following

    def stream(self, now: Situation, limits: MotionLimits, *, guarded: bool) -> Stream:
        """A stream from where the arm rests."""
        executor = self._executor
        stream = Stream(
            q_start=executor.state.q_ref,
            limits=limits,
            dt=executor.dt,
            stop_limits=GUARDED_STOP if guarded else executor.stop_limits(Channel.ARM),
            guard=self._guard(now) if guarded else None,
            check_range=now.range.check_path,
        )
        if guarded:
            self._newest = stream
        return stream

    def jog(self, now: Situation, limits: MotionLimits, frame: str) -> Jog:
        """A jog of one of the gripper's frames from where the arm rests."""
        executor = self._executor
        q = executor.state.q_ref
        model, collision, load = self._checks(now)
        servo = Servo(
            model, collision, limits, executor.dt, q, frame=frame, load=load,
            neighbours=self.neighbours,
        )  # fmt: skip
        jog = self._newest = Jog(servo, executor.dt, lambda: executor.state.q_jaw_ref)
        return jog

    def wall(self, now: Situation) -> GuidingWall:
        """A wall that a hand feels when it leads the arm into contact."""
        wall = self._newest = GuidingWall(self._guard(now), self.neighbours)
        return wall

    def renewal(self, now: Situation) -> Callable[[], None]:
        """Make a guard for this situation; the function returned takes it into use at once.

        What is under way is guarded by it, too; but not a following if what is held has become so
        much longer that it does not look often enough. Then only those after it are.
        """
        guard = self._new_guard(now)

        def use() -> None:
            self._made = now, guard
            newest = self._newest
            if isinstance(newest, Jog) and not newest.future.done():
                _, collision, load = self._checks(now)  # a jog does not share its guard
                newest.keep_off(collision, load)
            elif isinstance(newest, Stream | GuidingWall) or (
                isinstance(newest, Following)
                and newest.guard is not None
                and guard.look_every >= newest.guard.look_every
            ):
                newest.guard = guard

        return use

    def _guard(self, now: Situation) -> Guard:
        with self._lock:
            made = self._made
            if made is None or not made[0].is_same(now):
                made = self._made = now, self._new_guard(now)
            return made[1]

    def _new_guard(self, now: Situation) -> Guard:
        executor = self._executor
        _, collision, load = self._checks(now)
        return Guard(
            collision,
            lambda: executor.state.q_jaw_ref,
            load,
            acceleration=GUARDED_STOP.acceleration,
        )

    def _checks(self, now: Situation) -> tuple[RobotModel, CollisionModel, Load]:
        """The I/O thread's own model, and checks for contact and load."""
        model = self.model.narrowed(*now.range)
        load = now.load(model, self._executor.state.q_ref)
        return model, CollisionModel(model, now.scene), load


class GuidingWall:
    """Holds back the joints that a hand leads into contact; I/O thread only.

    The driver makes a wall of it that the hand feels (``drivers/feetech/hand_guiding.py``).
    ``guard`` can be replaced meanwhile.
    """

    def __init__(self, guard: Guard, neighbours: Neighbours | None) -> None:
        self.guard, self._neighbours = guard, neighbours

    def __call__(self, q: Array, q_guided: Array) -> Array:
        """How far a hand leads the joints from ``q``, shape (5,), to ``q_guided``, (k, 5)."""
        others = () if self._neighbours is None else self._neighbours.near_at(q)
        return self.guard.guided_to(q, q_guided, others)
