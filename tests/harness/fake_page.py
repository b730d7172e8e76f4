"""A fake arm, gripper and planner for the state of the Move tab."""

from __future__ import annotations

import time
from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from so101_viewer.page.target_ik import TargetSolver
from so101_viewer.view_model import MoveModel, ViewModel

from so101_motion.common.errors import OutsideLimits, Unreachable
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS, JointReading, JointState
from so101_motion.common.units import to_rad
from so101_motion.planning.goals import JointGoal, LeaveContactGoal
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Trajectory

REACH = 0.5
"""The fake arm's tool point is its first three angles, and it reaches this far [m]."""

WELCOME = "Welcome."

STILL = JointState(
    t=0.0,
    mode=Mode.HOLDING,
    reading=JointReading(q=np.zeros(5), qd=np.zeros(5), q_jaw=0.0, qd_jaw=0.0),
    q_ref=np.zeros(5),
    qd_ref=np.zeros(5),
    q_jaw_ref=0.0,
    arm_moving=False,
    jaw_moving=False,
    late_ticks=0,
)
"""An arm that rests and holds."""


def point(q, frame):
    return q[:3] if frame == "tool" else q[:3] + np.array([0.0, 0.0, 0.1])


def clearance(q, _q_jaw):
    """How far the fake arm is from the floor that it touches at -0.2 m."""
    return SimpleNamespace(distance=q[2] + 0.2, first="gripper", second="floor")


def check_limits(q):
    i = int(np.argmax(np.abs(q)))
    if abs(q[i]) > 2.0:
        raise OutsideLimits("far", joint=ARM_JOINTS[i], value=q[i], lower=-2.0, upper=2.0)


def candidates(goal, q_seed):
    p = goal.T_base_tool.p
    distance = float(np.linalg.norm(p))
    if distance > REACH:
        raise Unreachable(
            "too far",
            error_position=distance - REACH,
            error_angle=0.0,
            p_base_nearest=p * REACH / distance,
            q_nearest=np.append(p * REACH / distance, q_seed[3:]),
            limit="full stretch",
        )
    return [SimpleNamespace(q=np.append(p, q_seed[3:]))]


def contact(q, _q_jaw):
    return ("gripper", "floor") if q[2] < -0.2 else None


class FakePlan(SimpleNamespace):
    __eq__ = object.__eq__  # arrays have no one answer


def straight(q_start, q_goal):
    q = np.linspace(q_start, q_goal, 101)
    still = np.zeros_like(q)
    return FakePlan(
        q_start=q_start,
        q_goal=q_goal,
        trajectory=Trajectory(dt=0.01, q=q, qd=still, qdd=still, duration=1.0),
        tool_path=q[:, :3],
        limits=MotionLimits.uniform(velocity=1.0, acceleration=1.0, jerk=10.0),
        report=None,
        duration=1.0,
    )


class FakeArm:
    """An arm that is where it is told to be, and whose motions end when the test says so."""

    def __init__(self):
        self.speed = self.acceleration = 1.0
        self.stops = 0
        self.scene = object()
        self.range = (np.full(5, -2.0), np.full(5, 2.0))
        self.newest = None
        self.failure = None
        self.executed = []
        self.motion = SimpleNamespace(future=Future())
        self.state = STILL

    def be(self, q, *, t=0.0, mode=Mode.HOLDING, **trouble):
        reading = JointReading(q=q, qd=np.zeros(5), q_jaw=0.0, qd_jaw=0.0, **trouble)
        self.state = replace(
            self.state,
            t=t,
            reading=reading,
            q_ref=q,
            mode=mode,
            arm_moving=mode is Mode.MOVING,
            fault="servo 3 is hot" if mode is Mode.FAULT else None,
        )

    def set_speed(self, speed):
        self.speed = speed

    def set_acceleration(self, acceleration):
        self.acceleration = acceleration

    def plan(self, goal):
        if isinstance(goal, LeaveContactGoal):
            return straight(self.state.q_ref, self.state.q_ref + np.array([0.0, 0.0, 0.1, 0, 0]))
        if self.failure is not None:
            raise self.failure
        q = goal.q if isinstance(goal, JointGoal) else np.append(goal.T_base_tool.p, np.zeros(2))
        return straight(self.state.q_ref, q)

    def move(self, to, *, replan=False, wait):
        plan = self.plan(to) if replan else to
        self.executed.append(plan)
        self.motion = SimpleNamespace(future=Future(), plan=plan)
        return self.motion


class FakeGripper:
    def __init__(self):
        self.apertures = []
        self.is_holding = False

    def move(self, aperture, *, wait):
        self.apertures.append(aperture)


def run_at_once(call):
    future = Future()
    try:
        future.set_result(call())
    except Exception as error:
        future.set_exception(error)
    return future


def wait(model, clock, until):
    """Let simulated time pass until something is so; planner and workers take real time."""
    end = time.monotonic() + 60.0
    model.refresh()
    while not until():
        assert time.monotonic() < end, f"did not come true: {model.sentence.text}"
        clock.advance(0.01)
        model.refresh()


def pages_of(opened, clock):
    """The state of the Move tab of each arm of a cell, by its name."""
    return {
        name: ViewModel(
            arm=rig.arm,
            gripper=rig.gripper,
            load_solver=TargetSolver,
            submit=run_at_once,
            now=clock.now,
        )
        for name, rig in opened.rigs.items()
    }


class CellBench:
    """Arms of a cell and the model of a tab of their page, made by ``model_of(cell, arms)``."""

    def __init__(self, opened, clock, model_of):
        self.opened, self.clock = opened, clock
        self.arms = pages_of(opened, clock)
        self.model = model_of(opened.cell, self.arms)

    def plan(self):
        self.model.plan()
        self.model.refresh()
        return self.model

    def move(self, until):
        wait(self.model, self.clock, until)

    def says(self, words):
        return words in self.model.sentence.text


def aside(pan_deg):
    """Where an arm is that was turned a little further to the side; nobody is in its way."""
    return to_rad(np.array([pan_deg, 0.0, 0.0, 0.0, 0.0]))


class PageInputs:
    """What the page is given: a clock that the test drives, and solvers for some surroundings."""

    def __init__(self):
        self.t = 0.0
        self.loaded = []
        self.failure = None

    def now(self):
        return self.t

    def load_solver(self, *around):
        self.loaded.append(around)
        if self.failure is not None:
            raise self.failure
        return FakeSolver()


class FakeSolver(TargetSolver):
    """Inverse kinematics of the fake arm."""

    def __init__(self):
        self._model = SimpleNamespace(
            frame=lambda q, frame: SimpleNamespace(p=point(q, frame), R=np.eye(3)),
            check_limits=check_limits,
        )
        self._collisions = SimpleNamespace(clearance=clearance, first_contact=contact)
        self._ik = SimpleNamespace(candidates=candidates)


class OnePage(MoveModel):
    """The Move tab of one arm, and that arm."""

    def __init__(self, page, inputs):
        super().__init__(None, {"": page}, submit=run_at_once, now=inputs.now, welcome=WELCOME)

    def __getattr__(self, name):
        return getattr(self.arms[""], name)


def planned(page):
    page.plan()
    page.refresh()
    return page
