"""The arm as people use it: plan, move, retarget, stream, stop.

Everything here is synchronous and may be called from any thread. A call that moves returns a
``Motion`` at once; waiting for it is the caller's choice. A new motion supersedes the one under
way: the old one slows to rest and ends with ``Interrupted("a newer motion")``, then the new one is
planned from where the arm stands. Retargeting alone does not stop in between.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from so101_motion.arm_executor import ArmExecutor
from so101_motion.compliance import Compliance
from so101_motion.config import (
    ACCELERATION_RANGE_DEG,
    SPEED_RANGE_DEG,
    LoadConfig,
    checked_number,
    suggest,
)
from so101_motion.errors import ConfigError, MotionError, NotHolding, OutsideLimits
from so101_motion.executor import Channel, Stream
from so101_motion.geometry import SE3, Array, frozen_array
from so101_motion.jog import Jog
from so101_motion.modes import Mode
from so101_motion.motion import Motion
from so101_motion.planning.collision import CollisionModel
from so101_motion.planning.goals import Goal
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.plan import Plan, PlanRequest, Search
from so101_motion.planning.scene import Scene
from so101_motion.planning.servo import Servo
from so101_motion.planning.torque import Payload, Strength
from so101_motion.state import ARM_JOINTS, JointState, lent_out
from so101_motion.units import to_deg, to_rad

if TYPE_CHECKING:
    from so101_motion.planning.model import RobotModel

JERK_TIME = 0.1
"""Time to build up full acceleration [s]: jerk cap = acceleration cap / this. Chosen: at the
default 100 deg/s^2 the arm starts and stops without a visible jolt, and a move costs 0.1 s more."""

_RANGE_TOLERANCE = to_rad(0.2)
"""How far beyond its calibrated range a joint may be sent [rad]: two ticks."""

START_TOLERANCE = 1e-4
"""How far the arm may be from a plan's start when the plan is executed [rad]; the executor's."""


class Arm:
    """Five joints that can be planned for, moved and stopped.

    Args:
        model: Kinematics and limits.
        executor: Moves them; owned by the rig.
        planner: Takes a request to the planning process.
        speed: Joint speed cap [rad/s].
        acceleration: Joint acceleration cap [rad/s^2].
        scene: What is around it and in its hand.

    Attributes:
        scene: The same, for plans made from now on; replace it when things have changed.
        newest: The newest plan and what it was made for, for whoever shows it; None before.
        compliance: How it yields to a hand in manual mode.
        slowdown: Asked before each motion what share of its caps it may use, 0 to 1: hot servos
            are spared.
    """

    def __init__(
        self,
        *,
        model: RobotModel,
        executor: ArmExecutor,
        planner: Callable[[PlanRequest], Future[Plan]],
        speed: float,
        acceleration: float,
        scene: Scene,
    ) -> None:
        self.model = model
        self.scene = scene
        self._executor = executor
        self._planner = planner
        self._speed = self._acceleration = math.nan
        self._range = (model.lower, model.upper)
        self.set_load(LoadConfig())
        self.newest: tuple[PlanRequest, Plan] | None = None
        self.compliance = Compliance()
        self.slowdown: Callable[[], float] = lambda: 1.0
        self.set_speed(speed)
        self.set_acceleration(acceleration)
        self._lock = threading.Lock()
        self._kinematics = threading.Lock()  # Pinocchio's data is for one thread at a time
        self._current = Motion()
        self._current.future.set_result(None)
        self._threads = ThreadPoolExecutor(max_workers=4, thread_name_prefix="so101-arm")

    # What it is doing

    @property
    def state(self) -> JointState:
        """The newest snapshot; never waits."""
        return self._executor.state

    @property
    def is_moving(self) -> bool:
        """Whether a motion is under way, planning not included."""
        return self.state.arm_moving

    @property
    def in_manual(self) -> bool:
        """Whether the joints are to be moved by hand: guided, or limp."""
        return self.state.mode in (Mode.GUIDING, Mode.LIMP)

    def T_base(self, frame: str = "tool") -> SE3:
        """Where ``frame`` is now, from the measured joints; maps to the base frame."""
        with self._kinematics:
            return self.model.frame(self.state.q, frame)

    def T_base_links(self) -> dict[str, SE3]:
        """Where all seven links are now, by name, the jaw included."""
        state = self.state
        with self._kinematics:
            return self.model.link_placements(state.q, state.q_jaw)

    # How fast it may go

    @property
    def speed(self) -> float:
        """Joint speed cap [rad/s]."""
        return self._speed

    @property
    def acceleration(self) -> float:
        """Joint acceleration cap [rad/s^2]."""
        return self._acceleration

    def set_speed(self, speed: float) -> None:
        """Set the joint speed cap [rad/s] for motions that start from now on.

        Raises:
            ConfigError: Outside ``config.SPEED_RANGE_DEG``.
        """
        self._speed = _within("speed", speed, SPEED_RANGE_DEG, "deg/s")

    def set_acceleration(self, acceleration: float) -> None:
        """Set the joint acceleration cap [rad/s^2] for motions that start from now on.

        Raises:
            ConfigError: Outside ``config.ACCELERATION_RANGE_DEG``.
        """
        self._acceleration = _within(
            "acceleration", acceleration, ACCELERATION_RANGE_DEG, "deg/s^2"
        )

    @property
    def limits(self) -> MotionLimits:
        """The caps of a motion that names none of its own; see also ``slowdown``."""
        return MotionLimits.uniform(
            velocity=self._speed,
            acceleration=self._acceleration,
            jerk=self._acceleration / JERK_TIME,
        )

    def _eased(self, limits: MotionLimits | None) -> MotionLimits:
        caps, share = limits or self.limits, self.slowdown()
        if share >= 1.0:
            return caps
        return caps.scaled_to(share * caps.velocity, share * caps.acceleration)

    # What it bears

    def set_load(self, load: LoadConfig) -> None:
        """Say what the gripper always carries, beside what the scene attaches to it.

        Counts for plans made from now on, and with it what the arm's servos can bear.

        Raises:
            ConfigError: A mass or a place that cannot be meant, or servos that are not known.
        """
        zero = np.zeros(5)
        tip = (self.model.frame(zero).inverse @ self.model.frame(zero, "jaw_tip")).p
        x, y, z = tip.tolist() if load.com is None else load.com
        self._payload = Payload(mass=load.mass, com=(x, y, z)) if load.mass > 0.0 else None
        self._strength = Strength.of_servos(load.servo_voltage)

    # How far it may go

    @property
    def range(self) -> tuple[Array, Array]:
        """The smallest and the largest joint angles it may be sent to, shapes (5,), [rad]."""
        return self._range

    def set_range(self, lower: Array, upper: Array) -> None:
        """Narrow the joint limits to what this very arm was calibrated for, shapes (5,), [rad]."""
        self._range = (
            frozen_array(np.maximum(lower, self.model.lower), (5,)),
            frozen_array(np.minimum(upper, self.model.upper), (5,)),
        )

    def check_range(self, q: Array) -> None:
        """Refuse joint angles, shape (5,), [rad], that this arm cannot be sent to.

        Raises:
            OutsideLimits: Which joint, where to, and between what it may go.
        """
        lower, upper = self._range
        excess = np.maximum(lower - q, q - upper)
        i = int(np.argmax(excess))
        if excess[i] > _RANGE_TOLERANCE:
            raise OutsideLimits(
                f"{ARM_JOINTS[i]} at {to_deg(float(q[i])):.2f} deg is outside its calibrated range,"
                f" {to_deg(float(lower[i])):.2f} to {to_deg(float(upper[i])):.2f} deg; choose a"
                " value between them, or calibrate the arm again",
                joint=ARM_JOINTS[i],
                value=float(q[i]),
                lower=float(lower[i]),
                upper=float(upper[i]),
            )

    def _check_way(self, plan: Plan) -> None:
        """No setpoint may leave the range, unless the arm starts outside and is on its way in."""
        lower, upper = self._range
        lower, upper = np.minimum(lower, plan.q_start), np.maximum(upper, plan.q_start)
        q = plan.trajectory.q
        excess = np.max(np.maximum(lower - q, q - upper), axis=1)
        worst = int(np.argmax(excess))
        if excess[worst] > _RANGE_TOLERANCE:
            self.check_range(q[worst])

    # Planning and moving

    def plan(
        self,
        goal: Goal,
        *,
        limits: MotionLimits | None = None,
        search: Search | None = None,
        q_start: Array | None = None,
        q_jaw: float | None = None,
    ) -> Plan:
        """Plan from where the arm is wanted now, or will be then; moves nothing.

        Args:
            goal: What is wanted.
            limits: Caps of this motion; the arm's own if not given.
            search: How to look for it.
            q_start: Where an earlier motion will have brought the arm, shape (5,), [rad].
            q_jaw: Where the jaw will be [rad].

        Raises:
            PlanningError: Why there is no trajectory, with figures.
            WorkerError: The planning process died.
        """
        request = self._request(goal, limits, search)
        if q_start is not None:
            request = replace(request, q_start=q_start)
        if q_jaw is not None:
            request = replace(request, q_jaw=q_jaw)
        return self._noted(request, self._planner(request).result())

    def start_move(
        self, goal: Goal, *, limits: MotionLimits | None = None, search: Search | None = None
    ) -> Motion:
        """Plan and move; supersedes what is under way. Arguments as for ``plan``."""
        return self._start(lambda motion: self._plan_and_move(motion, goal, limits, search))

    def start_execute(self, plan: Plan) -> Motion:
        """Move along exactly this plan; supersedes what is under way.

        The motion fails with ``MotionError`` when the arm is no longer where the plan starts.
        """
        return self._start(lambda motion: self._execute(motion, plan))

    def start_series(self, steps: Iterable[Plan | Callable[[Motion], None]]) -> Motion:
        """Move along several plans, one after the other; supersedes what is under way.

        Args:
            steps: Plans, each beginning where the one before ends, and what is to be done between
                them while the arm stands: called with the motion, which may be interrupted then.
                Each is asked for when the one before is done.
        """

        def run(motion: Motion) -> None:
            for step in steps:
                if callable(step):
                    step(motion)
                else:
                    self._execute(motion, step)

        return self._start(run)

    def start_retarget(self, q_goal: Array, *, limits: MotionLimits | None = None) -> Motion:
        """Turn from the present motion straight towards ``q_goal``, shape (5,), [rad].

        For a stream of goals (teleoperation, dragging): does not stop in between and plans nothing,
        so the way is neither chosen nor checked for collisions, only the joint and motion limits
        are kept.

        Raises:
            OutsideLimits: The goal lies outside the joint limits.
        """
        q_goal = frozen_array(q_goal, (5,))
        self.model.check_limits(q_goal)
        self.check_range(q_goal)
        caps = self._eased(limits)
        motion = Motion()
        with self._lock:
            self._leave_manual()
            running = motion.begin(
                lambda: self._executor.retarget(q_goal, caps, channel=Channel.ARM),
                self._executor.interrupt,
            )
            previous, self._current = self._current, motion
        running.add_done_callback(motion.take_outcome)
        previous.interrupt("a newer motion")
        return motion

    def open_stream(self, *, limits: MotionLimits | None = None) -> Stream:
        """Take time-stamped points as they come; supersedes what is under way.

        Blocks until the arm is at rest, then returns the stream to push points into.
        """
        with self._lock:
            previous = self._current
        self._end(previous)
        with self._lock:
            self._leave_manual()
            return self._executor.open_stream(self._eased(limits))

    def open_jog(self, *, limits: MotionLimits | None = None, frame: str = "tool") -> Jog:
        """Let the tool be led by hand; supersedes what is under way.

        Blocks until the arm is at rest, then returns what takes the wishes. The arm keeps clear of
        itself and of the scene as it is now.

        Args:
            limits: Velocity and acceleration caps; the arm's own if not given.
            frame: Which frame of the gripper is led.

        Raises:
            ConfigError: There is no such frame.
        """
        known = self.model.gripper_frames
        if frame not in known:
            raise ConfigError(
                "frame", frame, f"is no frame of the gripper; {suggest(frame, known)}"
            )
        with self._lock:
            previous = self._current
        self._end(previous)
        with self._lock:
            self._leave_manual()
            model = self.model.narrowed(*self._range)  # the I/O thread's own
            executor = self._executor
            servo = Servo(
                model,
                CollisionModel(model, self.scene),
                self._eased(limits),
                executor.dt,
                self.state.q_ref,
                frame=frame,
            )
            jog = Jog(servo, executor.dt, lambda: executor.state.q_jaw_ref)
            executor.play(jog)
            return jog

    def stop(self) -> None:
        """Slow to rest along a jerk-limited ramp and hold; returns when the arm is at rest.

        On a real arm the joints have by then run up to a degree past where the ramp ends, and are
        drawn back there within the next half second. A motion under way, even one still being
        planned, ends with ``Interrupted("stop")``.
        """
        with self._lock:
            current = self._current
        current.interrupt("stop")
        self._executor.stop(Channel.ARM).result()

    def set_manual(self, enabled: bool, how: Compliance | None = None) -> None:
        """Let the arm yield to a hand and carry its own weight, or hold it where it is.

        Args:
            enabled: Whether it shall yield. A motion, a stop and letting go end that as well.
            how: How it yields; ``compliance`` if not given.
        """
        if enabled:
            self.stop()
            self._executor.guide(how or self.compliance).result()
        else:
            self._executor.hold().result()

    def set_torque(self, on: bool) -> None:
        """Hold the joints, the jaw too, or let go of them: the arm then sinks under its weight."""
        if on:
            self._executor.hold().result()
        else:
            self.stop()
            self._executor.release().result()

    def close(self) -> None:
        """End what is under way and the arm's own threads; the executor belongs to the rig."""
        with self._lock:
            current = self._current
        current.interrupt("shutdown")
        self._threads.shutdown(wait=True)

    # How

    def _request(
        self, goal: Goal, limits: MotionLimits | None, search: Search | None
    ) -> PlanRequest:
        state, search = self.state, search or Search()
        return PlanRequest(
            q_start=state.q_ref,
            goal=goal,
            limits=self._eased(limits),
            q_jaw=state.q_jaw_ref,
            scene=search.scene or self.scene,
            payload=self._payload,
            strength=self._strength,
            frames=search.frames,
            lower=self._range[0] - _RANGE_TOLERANCE,
            upper=self._range[1] + _RANGE_TOLERANCE,
            dt=self._executor.dt,
            seed=search.seed,
            time_budget=search.time_budget,
        )

    def _noted(self, request: PlanRequest, plan: Plan) -> Plan:
        self.newest = (request, plan)
        return plan

    def _start(self, run: Callable[[Motion], None]) -> Motion:
        motion = Motion()
        with self._lock:
            previous, self._current = self._current, motion
        self._threads.submit(self._run, motion, previous, run)
        return motion

    def _run(self, motion: Motion, previous: Motion, run: Callable[[Motion], None]) -> None:
        try:
            self._end(previous)
            run(motion)
        except BaseException as error:  # whoever waits for the motion must hear of it
            motion.future.set_exception(error)
        else:
            motion.future.set_result(None)

    def _end(self, previous: Motion) -> None:
        previous.interrupt("a newer motion")
        previous.future.exception()
        self._executor.stop(Channel.ARM).result()

    def _plan_and_move(
        self, motion: Motion, goal: Goal, limits: MotionLimits | None, search: Search | None
    ) -> None:
        self._leave_manual()
        request = self._request(goal, limits, search)
        plan = self._noted(request, motion.wait_for(self._planner(request)))
        self._execute(motion, plan)

    def _execute(self, motion: Motion, plan: Plan) -> None:
        self._leave_manual()
        off = float(np.max(np.abs(plan.q_start - self.state.q_ref)))
        if off > START_TOLERANCE:
            raise MotionError(
                f"the arm is {to_deg(off):.1f} deg away from where this plan starts; plan again"
            )
        self._check_way(plan)
        motion.plan = plan
        running = motion.begin(
            lambda: self._executor.execute(plan.trajectory, channel=Channel.ARM),
            self._executor.interrupt,
        )
        running.result()

    def _leave_manual(self) -> None:
        state = self.state
        if state.lent_to is not None:
            raise MotionError(lent_out(state.lent_to))
        if state.mode is Mode.FAULT:
            raise NotHolding(f"the arm is in a fault: {state.fault}; clear it, then hold again")
        if state.mode in (Mode.LIMP, Mode.GUIDING):
            self._executor.hold().result()


def _within(name: str, value: float, bounds_deg: tuple[float, float], unit: str) -> float:
    lower, upper = bounds_deg
    value_deg = round(to_deg(value), 9)  # 180 deg came in as a float in radians
    checked_number(name, value_deg, lower=lower, upper=upper, unit=unit)
    return value
