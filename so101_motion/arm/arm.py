"""Plan for an arm, move it, retarget it, jog it and stop it; any thread may call.

A new motion supersedes the one under way: that slows to rest and ends with ``Interrupted("a newer
motion")``, then the new one is planned from there. Only a retarget does not stop in between.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from contextlib import nullcontext, suppress
from dataclasses import replace
from functools import lru_cache, partial
from operator import is_
from typing import TYPE_CHECKING, Any, Literal, TypeVar, Unpack
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.arm.joint_caps import CappedJoints, JointCaps, JointRange
from so101_motion.arm.motion_handle import Motion, Step
from so101_motion.arm.motion_queue import MotionQueue, Opening, wait_here
from so101_motion.arm.open_ended_motions import OpenEndedMotions, Situation
from so101_motion.arm.protocols import ArmExecutor, OtherArms
from so101_motion.arm.replanned_motion import ReplannedMotion
from so101_motion.arm.stop_order import NUMBERS, STOP, refuse_older, request_number
from so101_motion.common.attributes import LoadConfig, checked_kind
from so101_motion.common.clock import Clock
from so101_motion.common.compliance import Compliance
from so101_motion.common.errors import (
    SUPERSEDED,
    ArmClosed,
    ConfigError,
    InCollision,
    Interrupted,
    MotionError,
    NotHolding,
)
from so101_motion.common.geometry import SE3, Array, joint_angles
from so101_motion.common.modes import Mode
from so101_motion.common.public import explained
from so101_motion.common.state import ARM_JOINTS, JointState, in_fault, lent_out
from so101_motion.common.units import angles_deg, in_mm, to_deg
from so101_motion.control.cartesian_jog import Jog
from so101_motion.control.following import APPROACH, GATE, STALE_AFTER, Following, FollowingSettings
from so101_motion.control.joint_group import Channel
from so101_motion.control.motion_source import S
from so101_motion.control.request_queue import running_future
from so101_motion.control.streamed_trajectory import Stream
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import MARGIN_TOLERANCE, Scene, Tool, checked_scene
from so101_motion.planning.goals import Goal, JointGoal, PoseGoal
from so101_motion.planning.request import Plan, PlanRequest, Search
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Payload, Strength
from so101_motion.planning.timing.trajectory import Trajectory

if TYPE_CHECKING:
    from so101_motion.planning.cell.team_requests import TeamTask
    from so101_motion.planning.kinematics.model import RobotModel


_log = logging.getLogger(__name__)

T = TypeVar("T")

_SPEED = "set_speed(...) is for all motions, limits=arm.limits.eased(0.5) for this one"
_told = explained(
    "it takes {}; a point is so101.point(x, y, z)",
    speed=_SPEED,
    velocity=_SPEED,
    acceleration=_SPEED,
)

Guard = Literal["scene"]
"""What a follow, stream or retarget keeps off: the arm itself, its scene, and other arms."""

SCENE: Guard = "scene"

PLANS = 3
"""How often a motion is planned at most while other arms keep getting in its way; chosen."""

START_TOLERANCE = 1e-4
"""How far the arm may be from a plan's start when the plan is executed [rad]; the executor's."""


class Arm(CappedJoints):
    """Five joints that can be planned for, moved and stopped.

    ``limits`` are always the caps of that motion, by default the arm's own. What ``follow``,
    ``stream`` and ``retarget`` begin keeps off nothing with ``guard=None``.

    Args:
        model: Kinematics and limits.
        executor: Moves the joints; owned by the rig.
        planner: Takes a request or a task to the planning process.
        clock: The executor's clock.
        speed: Joint speed cap [rad/s].
        acceleration: Joint acceleration cap [rad/s^2].
        scene: What is around the arm and in its hand.

    Attributes:
        newest: The newest plan and its request, for display; None before the first.
        cell_member: What keeps it clear of the other arms of its cell; None outside a cell.
        compliance: How it yields to a hand in manual mode.
        stops: How many stops were asked for, also while the arm was at rest.
        on_scene: Called with the scene before and the new one when it is set; None for nobody.
    """

    _shown = (
        "T_base T_base_links T_base_tool acceleration ceiling follow home is_movable_by_hand "
        "is_moving jog keep_off limits model move plan q range retarget scene set_acceleration "
        "set_load set_manual set_payload set_speed set_tool set_torque speed start_stream state "
        "stop stream tool touching"
    )

    def __init__(
        self,
        *,
        model: RobotModel,
        executor: ArmExecutor,
        planner: Callable[[Any], Future[Any]],
        clock: Clock,
        speed: float,
        acceleration: float,
        scene: Scene,
    ) -> None:
        super().__init__(JointCaps(speed=speed, acceleration=acceleration))
        self.model = self._bare = model
        self._tool: Tool | None = None
        self._scene, self._clock = scene, clock
        self._executor, self._planner = executor, planner
        self._range = JointRange(self.model.lower, self.model.upper)
        self._strength = Strength.of_servos(LoadConfig().servo_voltage)
        self.set_load(LoadConfig())
        self.newest: tuple[PlanRequest, Plan] | None = None
        self._planned_in = WeakKeyDictionary[Plan, tuple[Any, ...]]()
        self._kept_off: tuple[Scene, Scene] | None = None  # made from which scene, and which
        self.cell_member: OtherArms | None = None
        self._kinematics = threading.Lock()  # Pinocchio's data is for one thread at a time
        self._looking = threading.Lock()  # guards what follows
        self._looked_with: CollisionModel | None = None
        self.stops = 0
        self.on_scene: Callable[[Scene, Scene], None] | None = None
        self.compliance = Compliance()
        self._open_ended = OpenEndedMotions(self.model, self._executor)
        self._motions = MotionQueue(self._come_to_rest)

    def __repr__(self) -> str:
        if self._motions.is_closed:
            return "<Arm closed>"
        tool = in_mm(self.T_base_tool.p)
        return f"<Arm {self.state.mode.value} at {angles_deg(self.q)}, tool {tool}>"

    @property
    def newest_motion(self) -> Motion:
        """The motion asked for last, planning included; over when nothing is under way."""
        return self._motions.current

    # What it is, and where

    @property
    def scene(self) -> Scene:
        """What is around it and in its hand, for plans made from now on."""
        return self._scene

    @scene.setter
    def scene(self, scene: Scene) -> None:
        before, self._scene = self._scene, self._tooled(checked_scene(scene))
        if self.on_scene is not None:
            self.on_scene(before, self._scene)
        self._motions.current.wake()

    @property
    def tool(self) -> Tool | None:
        """What is fixed to the gripper for good; None for nothing."""
        return self._tool

    def set_tool(self, tool: Tool | None) -> None:
        """Fix a tool to the gripper, for plans and motions from now on; it is in every scene.

        Goals may name its frames, of which ``"tcp"`` is its point. Its mass counts besides the
        payload.
        """
        how = "a Tool; so101_motion.files.tool_file.find_tool reads one"
        checked_kind("tool", tool, Tool | None, how)
        scene = self._scene if self._tool is None else self._tool.off(self._scene)
        checked = scene if tool is None else tool.on(scene)
        model = self._bare
        for name, T_tool_frame in ({} if tool is None else tool.frames).items():
            model = model.with_frame(name, T_tool_frame)
        with self._kinematics, self._looking:
            self._tool, self.model, self._looked_with = tool, model, None
        self._open_ended.model = model
        self.scene = checked

    def _tooled(self, scene: Scene) -> Scene:
        return scene if self._tool is None else self._tool.on(scene)

    @property
    def state(self) -> JointState:
        """The newest snapshot; never waits. Of a closed arm it is the last one."""
        return self._executor.state

    @property
    def _open_state(self) -> JointState:
        """``state`` of an arm that is open; ``ArmClosed`` for the last one of a closed arm."""
        if self._motions.is_closed:
            raise ArmClosed
        return self.state

    @property
    def is_moving(self) -> bool:
        """Whether a motion is under way, also while it is being planned and until it has settled.

        ``state.arm_moving`` is whether joints move.
        """
        return self.state.arm_moving or not self.newest_motion.future.done()

    @property
    def is_movable_by_hand(self) -> bool:
        """Whether the joints can be moved by hand: guided, or limp."""
        return self.state.mode is Mode.GUIDING or self.state.is_limp

    @property
    def q(self) -> Array:
        """Where the joints are, measured, shape (5,), [rad]; ``ArmClosed`` of a closed arm."""
        return self._open_state.q

    @property
    def T_base_tool(self) -> SE3:
        """Where the tool is now, from the measured joints; maps to the base frame."""
        return self.T_base("tool")

    def T_base(self, frame: str = "tool") -> SE3:
        """Where ``frame`` is now, from the measured joints; maps to the base frame."""
        q = self.q
        with self._kinematics:
            return self.model.frame(q, frame)

    def T_base_links(self) -> dict[str, SE3]:
        """Where all seven links are now, by name, the jaw included."""
        state = self._open_state
        with self._kinematics:
            return self.model.link_placements(state.q, state.q_jaw)

    def touching(self) -> str:
        """What is nearer to each other now than it may be, such as ``"the jaw close to 'crate'"``.

        From the measured joints, with the scene, what ``keep_off`` adds, and the other arms of the
        cell; empty if nothing is. May take some hundredths of a second.
        """
        state, scene = self._open_state, self._situation.scene
        with self._looking:
            close = self._look_in(scene).first_contact(state.q, state.q_jaw)
        if close is None:
            return "" if self.cell_member is None else self.cell_member.touching()
        return " close to ".join(map(scene.called, close))

    def set_load(self, load: LoadConfig) -> None:
        """Set what the gripper always carries and how strong servos are, for plans from now on."""
        checked_kind("load", load, LoadConfig, f"a {LoadConfig.__module__}.LoadConfig(mass=...)")
        self._payload = Payload.of(load, self.model)
        self._strength = replace(
            Strength.of_servos(load.servo_voltage), shares=self._strength.shares
        )

    def set_payload(self, payload: Payload | None) -> None:
        """Set what the gripper carries, for plans from now on, until ``set_load`` is called."""
        how = "a so101.Payload(mass=..., com=(x, y, z)), in kg and metres in the tool frame"
        checked_kind("payload", payload, Payload | None, how)
        self._payload = payload

    def set_servo_strength(self, shares: Sequence[float]) -> None:
        """Set what share of its type's torque each joint's servo has, for plans from now on.

        A servo above 1 counts as 1: more torque makes more heat as well.
        """
        self._strength = replace(self._strength, shares=tuple(min(each, 1.0) for each in shares))

    @property
    def range(self) -> JointRange:
        """The joint limits that plans keep to."""
        return self._range

    def set_range(self, lower: Array, upper: Array) -> None:
        """Narrow the joint limits to those of the calibration, shapes (5,), [rad]."""
        self._range = JointRange(self.model.lower, self.model.upper).narrowed(lower, upper)

    # Planning and moving

    @_told
    def plan(
        self,
        goal: Goal | ArrayLike,
        *,
        limits: MotionLimits | None = None,
        search: Search | None = None,
        q_start: Array | None = None,
        q_jaw: float | None = None,
    ) -> Plan:
        """Plan from the arm's present reference, or from ``q_start``; moves nothing.

        Args:
            goal: What is wanted; or joint angles, shape (5,), [rad].
            limits: Caps of this motion.
            search: Options of the search.
            q_start: Plan from here instead, shape (5,), [rad].
            q_jaw: Where the jaw will be [rad].

        Raises:
            PlanningError: Why there is no trajectory, with figures.
            WorkerError: The planning process died.
            ArmClosed: The arm has been closed.
            Interrupted: The motion whose step called this was interrupted.
        """
        request = self.request(goal, limits=limits, search=search, q_start=q_start, q_jaw=q_jaw)
        present = self.present()
        plan: Plan = wait_here(self._planner(request))
        self.newest = (request, plan)
        self.note(plan, present)
        return plan

    @_told
    def move(
        self,
        to: Goal | Plan | ArrayLike,
        *,
        limits: MotionLimits | None = None,
        search: Search | None = None,
        replan: bool = False,
        wait: bool = True,
    ) -> Motion:
        """Move to a goal, or along a plan; supersedes what is under way.

        Args:
            to: A goal, which is planned for once the arm rests; joint angles, shape (5,), [rad]; or
                a plan, if the arm is where it starts. A plan of another arm, and one since which
                the scene, tool, load, range or caps were set, is checked again first.
            limits: Caps of this motion; the arm's own if not given. A plan has its own.
            search: Options of the search; for a goal alone.
            replan: For joint angles or a pose: plan again while it moves, without a stop, when
                ``scene`` changes, what ``keep_off`` adds, or the goal, by another such ``move``.
            wait: Return when the arm has settled. With False the motion is returned at once, and
                raises its errors from ``Motion.result``.

        Raises:
            PlanningError: Why there is no trajectory, or the plan does not hold any more.
            MotionError: The arm is not where the plan starts, or could not finish.
            Interrupted: A newer motion or a stop ended it.
        """
        if isinstance(to, Plan):
            for key, given in (("limits", limits), ("search", search), ("replan", replan or None)):
                if given is not None:
                    raise ConfigError(key, given, "is for a goal; this plan is already made")
            motion = self.start_series((lambda _: self.check_again(to),))
        elif replan:
            asked = search or Search()
            motion = self.start_replanned(
                _goal(to),
                lambda scene: replace(asked, scene=asked.scene or scene),
                limits=limits,
            )
        else:
            planning = partial(self.start_plan, _goal(to), limits=limits, search=search)
            motion = self.start_planned(planning)
        if wait:
            motion.result()
        return motion

    @_told
    def home(self, *, limits: MotionLimits | None = None, wait: bool = True) -> Motion:
        """Move all joints to zero, along a planned path; like ``move``."""
        return self.move(np.zeros(5), limits=limits, wait=wait)

    def consider(self, goal: Goal, *, search: Search | None = None) -> tuple[Motion, Future[Plan]]:
        """Plan for a motion that may be asked for next; the one under way goes on.

        What would supersede it, or a stop, interrupts the motion returned and cancels the plan.
        """
        planning = self.start_plan(goal, search=search)
        return self._motions.consider(planning), planning

    def start_planned(self, planning: Callable[[], Future[Plan]]) -> Motion:
        """Bring the arm to rest, let ``planning`` begin, and move; supersedes what is under way.

        ``planning`` is called on another thread; its future is cancelled with the motion.
        """

        def run(motion: Motion) -> None:
            self._leave_manual(motion)
            for _ in range(PLANS - 1):
                plan = motion.wait_for(planning())
                with suppress(InCollision):  # another arm has begun to move meanwhile
                    return self._execute(motion, plan)
            self._execute(motion, motion.wait_for(planning()))

        return self._motions.start(run)

    def start_replanned(
        self,
        goal: Goal,
        search: Callable[[Scene], Search],
        *,
        limits: MotionLimits | None = None,
    ) -> Motion:
        """Like ``move`` with ``replan``, but does not wait; ``search`` is made for each scene.

        Raises:
            ConfigError: The way to such a goal is prescribed, or other arms rely on this one's.
        """
        if not isinstance(goal, JointGoal | PoseGoal):
            raise ConfigError(
                "replan", True, "works for joint angles and poses; this goal prescribes the path"
            )
        if self.cell_member is not None and self.cell_member.minded:
            others = " and ".join(sorted(self.cell_member.minded))
            raise ConfigError(
                "replan", True, f"works for an arm that moves alone; {others} relies on this plan"
            )

        in_scene = lru_cache(maxsize=1)(search)

        def plan(search: Search, lead: Trajectory | None) -> Future[Plan]:
            return self.start_plan(goal, limits=limits, search=search, lead=lead)

        def run(motion: Motion) -> None:
            self._leave_manual(motion)
            ReplannedMotion(
                model=self.model,
                executor=self._executor,
                clock=self._clock,
                search=lambda: in_scene(self._situation.scene),
                plan=plan,
                limits=lambda: self.effective_limits(limits),
                check_path=self._range.check_path,
            ).run(motion)

        return self._motions.start(run, goes_on=True)

    def start_series(self, steps: Iterable[Step]) -> Motion:
        """Carry out several steps, one after the other; supersedes what is under way.

        ``steps`` are plans, each from where the one before ends, and functions that are called with
        the motion while the arm rests and may return a plan. Each is taken when the last is done.
        """

        def run(motion: Motion) -> None:
            self._leave_manual(motion)
            for step in steps:
                plan = step if isinstance(step, Plan) else step(motion)
                if plan is not None:
                    self._execute(motion, plan)

        return self._motions.start(run)

    def retarget(
        self, q_goal: Array, *, limits: MotionLimits | None = None, guard: Guard | None = SCENE
    ) -> Motion:
        """Move from the present motion straight to ``q_goal``, shape (5,), [rad], without a stop.

        For goals that come one by one, each replacing the one before. Nothing is planned: if an
        obstacle is in the way the arm stops short of it, and the motion raises what it was. A
        planned motion comes to rest along its own path first. Never waits.

        Raises:
            OutsideLimits: The goal lies outside the joint limits.
        """
        q_goal = self.model.within_limits(joint_angles("q_goal", q_goal))
        self._range.check(q_goal)
        make = self._maker(limits, guard=guard, stale_after=None, ends_there=True)

        def begin(motion: Motion) -> Future[None]:
            must_hold, following = self._must_hold(), make()
            following.aim(q_goal)
            with motion.begin():
                if must_hold:
                    self._executor.hold()  # before the turn, for requests are served in order
                running = self._executor.turn(following, channel=Channel.ARM)
                motion.halt = partial(self._executor.interrupt, running)
            return running

        if guard and not self._open_ended.has_guard(self._situation):
            return self._motions.start(begin)  # has a thread, which can make one
        return self._motions.take_over(begin)

    def stream(self, *, limits: MotionLimits | None = None, guard: Guard | None = SCENE) -> Stream:
        """Open a stream of time-stamped points once the arm rests; supersedes what is under way.

        Blocks until points can be pushed. The points are played as they come, within the limits. If
        they lead into contact with the arm itself, the table, the scene (and what ``keep_off``
        adds) or another arm of its cell, the arm stops before that, and the stream's future raises
        what is in the way.

        Raises:
            Interrupted: A newer motion or a stop was asked for meanwhile.
        """
        return self.start_stream(limits=limits, guard=guard).opened.result()

    def start_stream(
        self, *, limits: MotionLimits | None = None, guard: Guard | None = SCENE
    ) -> Opening[Stream]:
        """``stream`` without waiting until the arm rests; the result has the stream then."""
        caps, guarded = self.effective_limits(limits), _is_guarded(guard)
        return self._open_source(
            lambda: self._open_ended.stream(self._situation, caps, guarded=guarded)
        )

    def jog(self, *, limits: MotionLimits | None = None, frame: str = "tool") -> Jog:
        """Jog the tool, or another frame of the gripper; supersedes what is under way.

        Blocks until the arm rests. It keeps clear of itself, of the present scene, and of
        configurations in which its load is too heavy.

        Raises:
            ConfigError: There is no such frame.
            Interrupted: A newer motion or a stop was asked for meanwhile.
        """
        self.model.check_gripper_frame(frame)

        return self._open_source(
            lambda: self._open_ended.jog(self._situation, self.effective_limits(limits), frame)
        ).opened.result()

    def follow(
        self,
        *,
        limits: MotionLimits | None = None,
        guard: Guard | None = SCENE,
        approach: MotionLimits = APPROACH,
        gate: float = GATE,
        stale_after: float | None = STALE_AFTER,
        each: Callable[[Following], None] | None = None,
    ) -> Following:
        """Let the arm follow targets that are given to ``Following.aim``.

        Supersedes what is under way; blocks until the arm rests. The arm keeps clear of itself, of
        the present scene (and what ``keep_off`` adds), and of configurations in which its load is
        too heavy; it stops short of them or slides along. The jaw counts as it stands; its own
        motions are not guarded.

        Args:
            limits: Caps of the joints.
            guard: None to keep off nothing.
            approach: Caps while a first target is far.
            gate: A target is near when every joint is closer to it than this [rad].
            stale_after: After how long without a new target it brakes to rest [s]; None for never.
            each: Called with the following before every setpoint, on the I/O thread, as the last
                chance to aim; must be brief.

        Raises:
            Interrupted: A newer motion or a stop was asked for meanwhile.
            MotionError: This arm cannot follow targets.
        """
        make = self._maker(
            limits, guard=guard, approach=approach, gate=gate, stale_after=stale_after, each=each
        )
        return self._open_source(make).opened.result()

    def keep_off(self, own: Scene, around: Scene) -> None:
        """Let followings, streams and jogs keep off more than the arm's own scene, from now on.

        ``around`` is ``own``, the arm's scene, with further obstacles and held objects; when the
        arm has another scene, that counts alone. What is under way begins to keep off it, too.
        Plans do not know it. Takes some hundredths of a second.
        """
        use = self._open_ended.renewal(self._situation_in(around))
        self._kept_off = own, around
        use()
        self._motions.current.wake()

    def stop(self) -> None:
        """Slow to rest along a jerk-limited ramp and hold; returns when the arm rests.

        Real joints are then up to a degree past the end of the ramp, and are drawn back within half
        a second. The newest motion, even one being planned, ends with ``Interrupted("stop")``.
        """
        self.start_stop().result()

    def start_stop(self, *, by: str = STOP, number: int | None = None) -> Future[None]:
        """Like ``stop``, but does not wait; motions that it ends raise ``Interrupted(by)``.

        A stop ends motions of older requests before they begin; ``number``: its own, if it has one.
        """
        self.stops += 1
        self._motions.stop(by, number or (next(NUMBERS) if by == STOP else 0))
        return self._executor.stop(Channel.ARM, by=by)

    def set_manual(self, enabled: bool, compliance: Compliance | None = None) -> None:
        """Let a hand guide the arm (``compliance``: the arm's own by default), or hold it again.

        The hand feels a wall where it leads the arm into itself, into the scene (and what
        ``keep_off`` adds) or into another arm of its cell. A motion, a stop and letting go end
        manual mode as well.

        Raises:
            Interrupted: The arm was stopped after manual mode had been asked for; it holds.
        """
        if not checked_kind("enabled", enabled, bool, "True or False"):
            self._executor.hold().result()
            return
        compliance, asked = compliance or self.compliance, request_number()
        refuse_older(self._motions.stopped)
        self.start_stop(number=asked).result()
        wall = self._open_ended.wall(self._situation) if compliance.wall else None
        with self._motions.lock:  # a stop that comes later finds the request and ends it
            if self._motions.stopped > asked:
                raise Interrupted(STOP)
            guiding = self._executor.guide(compliance, wall)
        guiding.result()

    def set_torque(self, on: bool) -> None:
        """Hold all joints, or stop and release them: the arm then sinks. The jaw is a joint too."""
        if checked_kind("on", on, bool, "True or False"):
            self._executor.hold().result()
            return
        self.start_stop()
        try:
            self._executor.stop().result()  # the jaw as well
        finally:
            self._executor.release().result()

    def set_cell_member(self, member: OtherArms | None) -> None:
        """Keep off the other arms of a cell from now on; None ends that."""
        self.cell_member = self._open_ended.neighbours = member

    def close(self) -> None:
        """End what is under way and the arm's own threads; the executor belongs to the rig."""
        self._motions.close()

    def start_plan(
        self,
        goal: Goal,
        *,
        limits: MotionLimits | None = None,
        search: Search | None = None,
        lead: Trajectory | None = None,
    ) -> Future[Plan]:
        """Like ``plan``, but returns at once; cancelling the future ends the planning.

        ``lead``: how the arm, which moves, would come to rest; see ``PlanRequest``. One route is
        looked for then.
        """
        request = self.request(
            goal, limits=limits, search=search, q_start=None if lead is None else lead.q[-1]
        )
        if lead is not None:  # which does not wait
            request = replace(request, lead=lead, route_effort=1)
        present, planning = self.present(), self._planner(request)

        def note(done: Future[Plan]) -> None:
            if not done.cancelled() and done.exception() is None:
                self.newest = (request, done.result())
                self.note(done.result(), present)
                if reason := done.result().report.short_of_drive:
                    _log.info("the arm %s", reason)

        planning.add_done_callback(note)
        return planning

    def start_task(self, task: TeamTask[T]) -> Future[T]:
        """Have the planning process do a task of several motions; its request is ``request``'s."""
        return self._planner(task)

    def present(self) -> tuple[Any, ...]:
        """What plans depend on besides the arm's state; all but the scene is compared by ``is``."""
        scene, caps = self._with_surroundings(self.scene), (self._caps, self._ceiling)
        return scene, self.model, self._range, self._payload, self._strength, *caps

    def note(self, plan: Plan, present: tuple[Any, ...]) -> None:
        """Note what ``present`` was when a plan of this arm was asked for."""
        self._planned_in[plan] = present

    def check_again(self, plan: Plan, q_jaw: float | None = None) -> Plan:
        """``plan``, checked with what it depends on now, unless it was made with the same.

        Args:
            plan: Its motion counts, wherever the arm is.
            q_jaw: Where the jaw will be [rad]; its present setpoint if not given.

        Raises:
            PlanningError: It does not hold any more.
        """
        made, now = self._planned_in.get(plan), self.present()
        if made is not None and made[0] == now[0] and all(map(is_, made[1:], now[1:])):
            return plan
        has_own_caps = made is not None and made[-2] == self._caps
        verify.check(plan.trajectory, self._below_ceiling(plan.limits if has_own_caps else None))
        q, q_jaw = plan.trajectory.q, self.state.q_jaw_ref if q_jaw is None else q_jaw
        with self._looking:
            collision = self._look_in(now[0])
            if plan.report.departure:  # it begins in contact
                q = q[int(np.argmin(collision.touching(q, q_jaw))) :]
            blocked = collision.first_blocked(q, q_jaw, tolerance=MARGIN_TOLERANCE)
            met = None if blocked is None else collision.clearance(blocked, q_jaw)
        if met is not None:
            what = f"on this plan, which was made for another scene, {met.message()}; plan again"
            raise InCollision(what, first=met.first, second=met.second, where="path")
        load = self._situation_in(now[0]).load(self.model, plan.q_start)
        load.check(plan.trajectory)
        load.check_goal(plan.q_goal)
        return plan

    def request(
        self,
        goal: Goal | ArrayLike,
        *,
        limits: MotionLimits | None = None,
        search: Search | None = None,
        q_start: Array | None = None,
        q_jaw: float | None = None,
    ) -> PlanRequest:
        """The request that ``plan`` sends to the planner; arguments as there."""
        how = f"a {Search.__module__}.Search(...)"
        state = self._open_state
        search = checked_kind("search", search, Search | None, how) or Search()
        lower, upper = self._range.with_tolerance()
        return PlanRequest(
            q_start=state.q_ref if q_start is None else q_start,
            goal=_goal(goal),
            limits=self.effective_limits(limits),
            q_jaw=state.q_jaw_ref if q_jaw is None else q_jaw,
            scene=self._with_surroundings(self._tooled(search.scene or self.scene)),
            others=() if self.cell_member is None else self.cell_member.others(),
            payload=self._payload,
            strength=replace(self._strength, drive=self.drive()),
            frames={**({} if self._tool is None else self._tool.frames), **search.frames},
            lower=lower,
            upper=upper,
            dt=self._executor.dt,
            seed=search.seed,
            time_budget=search.time_budget,
            route_effort=search.route_effort,
        )

    def search_among_known(self) -> Search:
        """Options of a search among all that is known: its scene, and what ``keep_off`` adds."""
        return Search(scene=self._situation.scene)

    def _with_surroundings(self, scene: Scene) -> Scene:
        """The scene of a plan: ``scene`` and what else is known to be around the arm."""
        return scene

    # How

    @property
    def _situation(self) -> Situation:
        known = self._kept_off
        scene = self.scene if known is None or known[0] != self.scene else known[1]
        return self._situation_in(scene)

    def _look_in(self, scene: Scene) -> CollisionModel:
        """The collisions in a scene, for who holds ``_looking``."""
        if self._looked_with is None or self._looked_with.scene != scene:
            self._looked_with = CollisionModel(self.model, scene)
        return self._looked_with

    def _situation_in(self, scene: Scene) -> Situation:
        return Situation(self._tooled(scene), self._range, self._payload, self._strength)

    def _execute(self, motion: Motion, plan: Plan) -> None:
        self._leave_manual(motion)
        off = float(np.max(np.abs(plan.q_start - self.state.q_ref)))
        if off > START_TOLERANCE:
            raise MotionError(
                f"the arm is {to_deg(off):.2f} deg away from where this plan starts; plan again"
            )
        self._range.check_path(plan.trajectory.q)
        member, planned = self.cell_member, plan.trajectory
        with (
            nullcontext(planned)
            if member is None
            else member.entered(planned, partial(motion.pause_until, member.clock))
        ) as trajectory:
            motion.plan = plan
            with motion.begin():
                running = self._executor.execute(trajectory, channel=Channel.ARM)
                motion.halt = partial(self._executor.interrupt, running)
            running.result()

    def _maker(
        self, limits: MotionLimits | None, *, guard: Guard | None, **how: Unpack[FollowingSettings]
    ) -> Callable[[], Following]:
        caps, guarded = self.following_limits(limits), _is_guarded(guard)
        # The situation is that in which it begins: ``keep_off`` may be called before.
        return lambda: self._open_ended.following(
            self._situation, caps, guarded=guarded, share=self.slowdown, **how
        )

    def _open_source(self, make: Callable[[], S]) -> Opening[S]:
        """Begin the open-ended motion that ``make`` prepares, once the arm rests."""
        opened: Future[S] = running_future()

        def run(motion: Motion) -> Future[None]:
            self._leave_manual(motion)
            source = make()
            with motion.begin():
                self._executor.play(source)
                motion.halt = partial(self._executor.interrupt, source.future)
            opened.set_result(source)
            return source.future

        def end(over: Future[None]) -> None:
            error = over.exception()
            if error is not None and not opened.done():
                opened.set_exception(error)

        motion = self._motions.start(run)
        motion.future.add_done_callback(end)
        return Opening(motion, opened)

    def _come_to_rest(self) -> Future[None] | None:
        """Slow down for a newer motion; None if the arm rests."""
        if self._executor.is_resting:
            return None
        return self._executor.stop(Channel.ARM, by=SUPERSEDED)

    def _leave_manual(self, motion: Motion) -> None:
        """Hold an arm that yields or is limp, unless the motion was ended meanwhile."""
        if self._must_hold():
            with motion.begin():
                holding = self._executor.hold()
            holding.result()
        self.state.reading.check_held(ARM_JOINTS)  # rather than where a sunken arm lies

    def _must_hold(self) -> bool:
        """Whether the arm is guided or limp, so that it must hold before it moves."""
        state = self.state
        if state.lent_to is not None:
            raise MotionError(lent_out(state.lent_to))
        if state.mode is Mode.FAULT:
            raise NotHolding(in_fault(state.fault))
        return self.is_movable_by_hand


def _is_guarded(guard: Guard | None) -> bool:
    if guard not in (SCENE, None):
        raise ConfigError("guard", guard, 'must be "scene", or None to keep off nothing')
    return guard is not None


def _goal(to: Goal | ArrayLike) -> Goal:
    """A goal as it is, or that of five joint angles; ``ConfigError`` if these are not five."""
    if isinstance(to, Goal):
        return to
    if isinstance(to, str):
        raise ConfigError("goal", to, f"a named pose is so101.SavedPoses().find({to!r}).q")
    if isinstance(to, SE3) or getattr(getattr(to, "homogeneous", to), "shape", ()) == (4, 4):
        how = 'PoseGoal(T_base_tool=..., metric="position_only")'
        more = '"position_and_approach" or "full_pose"'
        raise ConfigError("goal", to, f"say how much of the pose counts: {how}, {more}")
    try:
        return JointGoal(q=joint_angles("goal", to))
    except ConfigError as error:
        more = ""
        if not isinstance(to, Sequence | np.ndarray) or getattr(to, "shape", None) == ():
            more = ", or a goal such as so101.point(0.25, 0.1, 0.1)"
        elif len(to) and isinstance(to[0], Goal | list | tuple | np.ndarray):
            more = "; of several points a ToolPathGoal is made, of rows of angles a PathGoal"
        raise ConfigError("goal", to, error.reason + more) from None
