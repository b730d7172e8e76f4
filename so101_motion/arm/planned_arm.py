"""The part of ``Arm`` that plans: it collects state, range, load and surroundings for a request."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace
from typing import TYPE_CHECKING, TypedDict, Unpack

from so101_motion.arm.joint_caps import CappedJoints, JointCaps, JointRange
from so101_motion.arm.open_ended_motions import Situation
from so101_motion.arm.protocols import ArmExecutor, OtherArms
from so101_motion.common.attributes import LoadConfig
from so101_motion.common.clock import Clock
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.modes import Mode
from so101_motion.common.state import JointState
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import Goal
from so101_motion.planning.request import Plan, PlanRequest, Search
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Payload, Strength
from so101_motion.planning.timing.trajectory import Trajectory

if TYPE_CHECKING:
    from so101_motion.planning.kinematics.model import RobotModel


class ArmParts(TypedDict):
    """What an arm is made of.

    Attributes:
        model: Kinematics and limits.
        executor: Moves the joints; owned by the rig.
        planner: Takes a request to the planning process.
        clock: The executor's clock.
        speed: Joint speed cap [rad/s].
        acceleration: Joint acceleration cap [rad/s^2].
        scene: What is around the arm and in its hand.
    """

    model: RobotModel
    executor: ArmExecutor
    planner: Callable[[PlanRequest], Future[Plan]]
    clock: Clock
    speed: float
    acceleration: float
    scene: Scene


class PlannedArm(CappedJoints):
    """Five joints that can be planned for.

    Args:
        parts: See ``ArmParts``.

    Attributes:
        model: Kinematics and limits.
        newest: The newest plan and its request, for display; None before the first.
        cell_member: What keeps it clear of the other arms of its cell; None outside a cell.
    """

    def __init__(self, **parts: Unpack[ArmParts]) -> None:
        super().__init__(JointCaps(speed=parts["speed"], acceleration=parts["acceleration"]))
        self.model, self._scene = parts["model"], parts["scene"]
        self._executor, self._planner = parts["executor"], parts["planner"]
        self._clock = parts["clock"]
        self._range = JointRange(self.model.lower, self.model.upper)
        self._strength = Strength.of_servos(LoadConfig().servo_voltage)
        self.set_load(LoadConfig())
        self.newest: tuple[PlanRequest, Plan] | None = None
        self._kept_off: tuple[Scene, Scene] | None = None  # made from which scene, and which
        self.cell_member: OtherArms | None = None
        self._kinematics = threading.Lock()  # Pinocchio's data is for one thread at a time
        self._looking = threading.Lock()  # guards what follows
        self._looked_with: CollisionModel | None = None

    @property
    def scene(self) -> Scene:
        """What is around it and in its hand, for plans made from now on."""
        return self._scene

    @scene.setter
    def scene(self, scene: Scene) -> None:
        self._scene = scene
        self._look_around()

    def _look_around(self) -> None:
        """Called when the scene, or what ``keep_off`` adds to it, has changed."""

    @property
    def state(self) -> JointState:
        """The newest snapshot; never waits."""
        return self._executor.state

    @property
    def is_moving(self) -> bool:
        return self.state.arm_moving

    @property
    def is_movable_by_hand(self) -> bool:
        """Whether the joints can be moved by hand: guided, or limp."""
        return self.state.mode in (Mode.GUIDING, Mode.LIMP)

    @property
    def q(self) -> Array:
        """Where the joints are, measured, shape (5,), [rad]."""
        return self.state.q

    @property
    def T_base_tool(self) -> SE3:
        """Where the tool is now, from the measured joints; maps to the base frame."""
        return self.T_base("tool")

    def T_base(self, frame: str = "tool") -> SE3:
        """Where ``frame`` is now, from the measured joints; maps to the base frame."""
        with self._kinematics:
            return self.model.frame(self.state.q, frame)

    def T_base_links(self) -> dict[str, SE3]:
        """Where all seven links are now, by name, the jaw included."""
        state = self.state
        with self._kinematics:
            return self.model.link_placements(state.q, state.q_jaw)

    def touching(self) -> str:
        """What is nearer to each other now than it may be, such as ``"the jaw close to 'crate'"``.

        From the measured joints, with the scene, what ``keep_off`` adds, and the other arms of the
        cell; empty if nothing is. May take some hundredths of a second.
        """
        state, scene = self.state, self._situation.scene
        with self._looking:
            collision = self._looked_with
            if collision is None or collision.scene != scene:
                collision = self._looked_with = CollisionModel(self.model, scene)
            close = collision.first_contact(state.q, state.q_jaw)
        if close is None:
            return "" if self.cell_member is None else self.cell_member.touching()
        return " close to ".join(map(scene.called, close))

    def set_load(self, load: LoadConfig) -> None:
        """Set what the gripper always carries and how strong the servos are, for plans from now on.

        Raises:
            ConfigError: A mass or position is out of range, or the servos are unknown.
        """
        self._payload = Payload.of(load, self.model)
        self._strength = replace(
            Strength.of_servos(load.servo_voltage), shares=self._strength.shares
        )

    def set_payload(self, payload: Payload) -> None:
        """Set what the gripper carries, for plans from now on, until ``set_load`` is called."""
        self._payload = payload

    def set_servo_strength(self, shares: Sequence[float]) -> None:
        """Set what share of its type's torque each joint's servo has, for plans from now on.

        A servo above 1 counts as 1: more torque makes more heat as well.
        """
        self._strength = replace(self._strength, shares=tuple(min(each, 1.0) for each in shares))

    @property
    def range(self) -> JointRange:
        return self._range

    def set_range(self, lower: Array, upper: Array) -> None:
        """Narrow the joint limits to those of the calibration, shapes (5,), [rad]."""
        self._range = JointRange(self.model.lower, self.model.upper).narrowed(lower, upper)

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
        planning = self._planner(request)

        def note(done: Future[Plan]) -> None:
            if not done.cancelled() and done.exception() is None:
                self.newest = (request, done.result())

        planning.add_done_callback(note)
        return planning

    def request(
        self,
        goal: Goal,
        *,
        limits: MotionLimits | None = None,
        search: Search | None = None,
        q_start: Array | None = None,
        q_jaw: float | None = None,
    ) -> PlanRequest:
        """The request that ``plan`` sends to the planner; arguments as there."""
        state, search = self.state, search or Search()
        lower, upper = self._range.with_tolerance()
        return PlanRequest(
            q_start=state.q_ref if q_start is None else q_start,
            goal=goal,
            limits=self.effective_limits(limits),
            q_jaw=state.q_jaw_ref if q_jaw is None else q_jaw,
            scene=self._with_surroundings(search.scene or self.scene),
            others=() if self.cell_member is None else self.cell_member.others(),
            payload=self._payload,
            strength=self._strength,
            frames=search.frames,
            lower=lower,
            upper=upper,
            dt=self._executor.dt,
            seed=search.seed,
            time_budget=search.time_budget,
            route_effort=search.route_effort,
        )

    def _with_surroundings(self, scene: Scene) -> Scene:
        """The scene of a plan: ``scene`` and what else is known to be around the arm."""
        return scene

    @property
    def _situation(self) -> Situation:
        known = self._kept_off
        scene = self.scene if known is None or known[0] != self.scene else known[1]
        return self._situation_in(scene)

    def _situation_in(self, scene: Scene) -> Situation:
        return Situation(scene, self._range, self._payload, self._strength)
