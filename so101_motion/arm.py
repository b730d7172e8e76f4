"""The arm as people use it: plan, move, retarget, stream, stop.

Everything here is synchronous and may be called from any thread. A call that moves returns a
``Motion`` at once; waiting for it is the caller's choice. A new motion supersedes the one under
way: the old one slows to rest and ends with ``Interrupted("a newer motion")``, then the new one is
planned from where the arm stands. Retargeting alone does not stop in between.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from so101_motion.arm_executor import ArmExecutor
from so101_motion.caps import Caps
from so101_motion.compliance import Compliance
from so101_motion.config import LoadConfig
from so101_motion.errors import MotionError, NotHolding
from so101_motion.executor import Channel, Stream
from so101_motion.geometry import SE3, Array, frozen_array
from so101_motion.jog import Jog
from so101_motion.joint_range import JointRange
from so101_motion.modes import Mode
from so101_motion.motion import Motion
from so101_motion.planning.collision import CollisionModel
from so101_motion.planning.goals import Goal
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.plan import Plan, PlanRequest, Search
from so101_motion.planning.scene import Scene
from so101_motion.planning.servo import Servo
from so101_motion.planning.torque import Load, Payload, Strength, carried
from so101_motion.state import JointState, lent_out
from so101_motion.succession import Succession
from so101_motion.units import to_deg

if TYPE_CHECKING:
    from so101_motion.planning.model import RobotModel

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
        self._caps = Caps(speed=speed, acceleration=acceleration)
        self._range = JointRange(model.lower, model.upper)
        self.set_load(LoadConfig())
        self.newest: tuple[PlanRequest, Plan] | None = None
        self.compliance = Compliance()
        self.slowdown: Callable[[], float] = lambda: 1.0
        self._kinematics = threading.Lock()  # Pinocchio's data is for one thread at a time
        self._motions = Succession(lambda: executor.stop(Channel.ARM))

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
        return self._caps.speed

    @property
    def acceleration(self) -> float:
        """Joint acceleration cap [rad/s^2]."""
        return self._caps.acceleration

    def set_speed(self, speed: float) -> None:
        """Set the joint speed cap [rad/s] for motions that start from now on.

        Raises:
            ConfigError: Outside ``config.SPEED_RANGE_DEG``.
        """
        self._caps = replace(self._caps, speed=speed)

    def set_acceleration(self, acceleration: float) -> None:
        """Set the joint acceleration cap [rad/s^2] for motions that start from now on.

        Raises:
            ConfigError: Outside ``config.ACCELERATION_RANGE_DEG``.
        """
        self._caps = replace(self._caps, acceleration=acceleration)

    @property
    def limits(self) -> MotionLimits:
        """The caps of a motion that names none of its own; see also ``slowdown``."""
        return self._caps.limits

    def _eased(self, limits: MotionLimits | None) -> MotionLimits:
        return (limits or self.limits).eased(self.slowdown())

    # What it bears

    def set_load(self, load: LoadConfig) -> None:
        """Say what the gripper always carries, beside what the scene attaches to it.

        Counts for plans made from now on, and with it what the arm's servos can bear.

        Raises:
            ConfigError: A mass or a place that cannot be meant, or servos that are not known.
        """
        self._payload = Payload.of(load, self.model)
        self._strength = Strength.of_servos(load.servo_voltage)

    # How far it may go

    @property
    def range(self) -> JointRange:
        """Between which joint angles it may be sent."""
        return self._range

    def set_range(self, lower: Array, upper: Array) -> None:
        """Narrow the joint limits to what this very arm was calibrated for, shapes (5,), [rad]."""
        self._range = JointRange(self.model.lower, self.model.upper).narrowed(lower, upper)

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
        return self._motions.start(lambda motion: self._plan_and_move(motion, goal, limits, search))

    def start_execute(self, plan: Plan) -> Motion:
        """Move along exactly this plan; supersedes what is under way.

        The motion fails with ``MotionError`` when the arm is no longer where the plan starts.
        """
        return self._motions.start(lambda motion: self._execute(motion, plan))

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

        return self._motions.start(run)

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
        self._range.check(q_goal)
        caps, executor = self._eased(limits), self._executor

        def begin(motion: Motion) -> Future[None]:
            self._leave_manual(motion)
            return motion.begin(
                lambda: executor.retarget(q_goal, caps, channel=Channel.ARM), executor.interrupt
            )

        return self._motions.turn(begin)

    def open_stream(self, *, limits: MotionLimits | None = None) -> Stream:
        """Take time-stamped points as they come; supersedes what is under way.

        Blocks until the arm is at rest, then returns the stream to push points into.
        """
        with self._motions.at_rest():
            self._leave_manual(Motion())
            return self._executor.open_stream(self._eased(limits))

    def open_jog(self, *, limits: MotionLimits | None = None, frame: str = "tool") -> Jog:
        """Let the tool be led by hand; supersedes what is under way.

        Blocks until the arm is at rest, then returns what takes the wishes. The arm keeps clear of
        itself and of the scene as it is now, and of postures too heavy for what it carries.

        Args:
            limits: Caps of the joints; the arm's own if not given.
            frame: Which frame of the gripper is led.

        Raises:
            ConfigError: There is no such frame.
        """
        self.model.check_gripper_frame(frame)
        with self._motions.at_rest():
            self._leave_manual(Motion())
            executor, scene, q = self._executor, self.scene, self.state.q_ref
            model = self.model.narrowed(*self._range)  # the I/O thread's own
            servo = Servo(
                model,
                CollisionModel(model, scene),
                self._eased(limits),
                executor.dt,
                q,
                frame=frame,
                load=Load.of(model, self._strength, q, carried(self._payload, scene.attached)),
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
        self._motions.interrupt("stop")
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
        self._motions.close()

    # How

    def _request(
        self, goal: Goal, limits: MotionLimits | None, search: Search | None
    ) -> PlanRequest:
        state, search = self.state, search or Search()
        lower, upper = self._range.with_tolerance()
        return PlanRequest(
            q_start=state.q_ref,
            goal=goal,
            limits=self._eased(limits),
            q_jaw=state.q_jaw_ref,
            scene=search.scene or self.scene,
            payload=self._payload,
            strength=self._strength,
            frames=search.frames,
            lower=lower,
            upper=upper,
            dt=self._executor.dt,
            seed=search.seed,
            time_budget=search.time_budget,
        )

    def _noted(self, request: PlanRequest, plan: Plan) -> Plan:
        self.newest = (request, plan)
        return plan

    def _plan_and_move(
        self, motion: Motion, goal: Goal, limits: MotionLimits | None, search: Search | None
    ) -> None:
        self._leave_manual(motion)
        request = self._request(goal, limits, search)
        plan = self._noted(request, motion.wait_for(self._planner(request)))
        self._execute(motion, plan)

    def _execute(self, motion: Motion, plan: Plan) -> None:
        self._leave_manual(motion)
        off = float(np.max(np.abs(plan.q_start - self.state.q_ref)))
        if off > START_TOLERANCE:
            raise MotionError(
                f"the arm is {to_deg(off):.1f} deg away from where this plan starts; plan again"
            )
        self._range.check_way(plan.trajectory.q)
        motion.plan = plan
        running = motion.begin(
            lambda: self._executor.execute(plan.trajectory, channel=Channel.ARM),
            self._executor.interrupt,
        )
        running.result()

    def _leave_manual(self, motion: Motion) -> None:
        """Hold an arm that yields or is limp; not for a motion that has been ended meanwhile."""
        state = self.state
        if state.lent_to is not None:
            raise MotionError(lent_out(state.lent_to))
        if state.mode is Mode.FAULT:
            raise NotHolding(f"the arm is in a fault: {state.fault}; clear it, then hold again")
        if state.mode in (Mode.LIMP, Mode.GUIDING):
            motion.begin(self._executor.hold, lambda _holding, _by: None).result()
