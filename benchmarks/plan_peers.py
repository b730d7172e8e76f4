"""Other planners on the same problems, if they are installed: OMPL, roboplan and sscbirrt.

OMPL and sscbirrt call the very same compiled checks as our search, once for each edge: the margins
at samples ``SPACING`` of travel apart. They do not prove their paths, as ours are in the end.
OMPL's RRT-Connect has the best of five ranges and its own simplifier; its AORRTC, which shortens
until its time is up, is the peer for routes. sscbirrt has the best of three step sizes and its own
smoothing; its search runs in Python, because its compiled one takes no check of others.

roboplan brings a collision model of its own, in C++ on Pinocchio and coal like ours: it gets the
same hulls, pairs, floor and obstacles, the hulls as surfaces, and keeps no margin. Its edges are
looked at every 0.05 rad, its paths shortened by its own shortcutting.

``pip install ompl==2.0.1 roboplan==0.7.0 sscbirrt==3.15.0``; none of them is a dependency.
"""

from __future__ import annotations

import ctypes
import importlib
import re
import time
from collections.abc import Callable, Iterator
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import so101_description

from benchmarks.plan_problems import Problem
from so101_motion.common.geometry import Array
from so101_motion.planning.collision.batch_check import pointer
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import FLOOR, Box, Scene
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.paths.path import SPACING

STEP = 0.05
"""Distance of the postures that roboplan looks at on an edge [rad]."""

RANGE = 1.0
"""Longest branch in OMPL's trees and in sscbirrt's [rad]. Chosen: of 0.3, 0.6, 1.0, 1.5 and OMPL's
default, 1.8, none is quicker on the shelf, the slot and the blocked table together."""

TIME = 1.0
"""When a search gives up [s]; ours and OMPL's take a third of it at most."""

ROUTE_TIME = 0.1
"""How long AORRTC looks for a shorter route, CPU time [s]."""

Attempt = Callable[[], Iterator[Array | None]]
"""One search, set up and ready to go: the path as found, then what it is made of that, if anything.
Waypoints, shape (m, 5), [rad], or None."""

Prepare = Callable[[int, Problem], Attempt]
"""From a seed and a problem to a search."""


def ompl_search(model: RobotModel, scene: Scene, planner: str = "RRTConnect") -> Prepare | None:
    """A planner of OMPL and its simplifier under our checks, or None if not installed."""
    try:
        base: Any = importlib.import_module("ompl.base")
        geometric: Any = importlib.import_module("ompl.geometric")
        util: Any = importlib.import_module("ompl.util")
    except ImportError:
        return None
    util.setLogLevel(util.LogLevel.LOG_NONE)
    collision = CollisionModel(model, scene)
    check = collision.sampled_check(spacing=SPACING)
    space = base.RealVectorStateSpace(5)
    bounds = base.RealVectorBounds(5)
    for i, (lower, upper) in enumerate(model.limits):
        bounds.setLow(i, lower)
        bounds.setHigh(i, upper)
    space.setBounds(bounds)
    ends, of = np.zeros((2, 5)), check.checkers[0]
    is_clear = partial(
        check.library.so101_is_clear,
        *(ctypes.c_void_p(each) for each in (of.scene, of.levels, of.reach)),
        *(ctypes.c_double(of.spacing), pointer(ends[0]), pointer(ends[1])),
        *(ctypes.c_double(of.q_jaw), 1),
    )

    class Edges(base.MotionValidator):  # type: ignore[misc]
        def checkMotion(self, a: Any, b: Any) -> bool:
            ends[0], ends[1] = [a[i] for i in range(5)], [b[i] for i in range(5)]
            return bool(is_clear())

    def prepare(seed: int, problem: Problem) -> Attempt:
        setup = geometric.SimpleSetup(space)
        setup.setStateValidityChecker(lambda state: collision.is_free([state[i] for i in range(5)]))
        information = setup.getSpaceInformation()
        information.setMotionValidator(Edges(information))
        chosen = getattr(geometric, planner)(information)
        chosen.setRange(RANGE)
        setup.setPlanner(chosen)
        states = [space.allocState(), space.allocState()]
        for state, q in zip(states, problem, strict=True):
            for i in range(5):
                state[i] = float(q[i])
        setup.setStartAndGoalStates(*states)
        setup.setup()

        def path() -> Array:
            states = setup.getSolutionPath().getStates()
            return np.array([[state[i] for i in range(5)] for state in states])

        def attempt() -> Iterator[Array | None]:
            end = time.thread_time() + (TIME if planner == "RRTConnect" else ROUTE_TIME)
            if not setup.solve(base.PlannerTerminationCondition(lambda: time.thread_time() > end)):
                yield None
                return
            yield path()
            setup.simplifySolution()
            yield path()

        return attempt

    return prepare


def sscbirrt_search(model: RobotModel, scene: Scene) -> Prepare | None:
    """The search and smoothing of sscbirrt under our checks, or None if not installed."""
    try:
        peer: Any = importlib.import_module("sscbirrt")
        motion: Any = importlib.import_module("sscbirrt.motion")
    except ImportError:
        return None
    collision = CollisionModel(model, scene)
    check = collision.sampled_check(spacing=SPACING)
    free = SimpleNamespace(is_valid=check.is_free)

    def validate(a: Array, b: Array) -> Any:
        clear = check.is_free(b) and check.is_clear(a, b)
        return motion.LocalMotion([b] if clear else [], clear)

    arm = SimpleNamespace(dof=5, joint_limits=(model.lower, model.upper))
    planner = peer.CBiRRT(
        arm, None, free, peer.CBiRRTConfig(step_size=RANGE, timeout=TIME), backend="python"
    )

    def prepare(seed: int, problem: Problem) -> Attempt:
        start, goal = (peer.FiniteSet([q], metric=planner.space.distance) for q in problem)
        asked = peer.PlanningProblem(
            space=planner.space,
            start=start,
            goal=goal,
            validator=free,
            motion_validator=SimpleNamespace(validate=validate),
        )

        def attempt() -> Iterator[Array | None]:
            found = planner.solve(asked, seed=seed)
            yield np.array(found.path) if found.success else None

        return attempt

    return prepare


def roboplan_search(model: RobotModel, scene: Scene) -> Prepare | None:
    """The RRT-Connect and the shortcutting of roboplan, or None if not installed or for clouds."""
    if not all(isinstance(each.shape, Box) for each in scene.obstacles):
        return None
    try:
        core: Any = importlib.import_module("roboplan.core")
        rrt: Any = importlib.import_module("roboplan.rrt")
    except ImportError:
        return None
    arm = _roboplan_scene(core, model, scene)
    names = arm.getJointNames()
    options = rrt.RRTOptions(
        max_nodes=100_000,
        max_connection_distance=1.0,
        collision_check_step_size=STEP,
        max_planning_time=TIME,
        rrt_connect=True,
    )

    def prepare(seed: int, problem: Problem) -> Attempt:
        planner = rrt.RRT(arm, options)
        planner.setRngSeed(seed + 1)
        start, goal = (core.JointConfiguration(names, q) for q in problem)
        shortening = core.PathShortcuttingOptions(max_step_size=STEP, seed=seed)
        shortcutter = core.PathShortcutter(arm, shortening)

        def attempt() -> Iterator[Array | None]:
            try:
                path = planner.plan(start, goal)
            except RuntimeError:
                yield None
                return
            yield np.array(path.positions)
            yield np.array(shortcutter.shortcut(path).positions)

        return attempt

    return prepare


def _roboplan_scene(core: Any, model: RobotModel, scene: Scene) -> Any:
    """The same arm, closed gripper, with the same pairs of bodies."""
    urdf = so101_description.URDF_PATH.read_text(encoding="utf-8")
    urdf = re.sub(r'(<joint name="gripper" type=)"revolute"', r'\1"fixed"', urdf)
    folder = so101_description.URDF_PATH.parent
    urdf = urdf.replace('filename="meshes/', f'filename="{folder}/meshes/')
    description = core.loadUrdfSceneDescriptionFromXml(urdf, [str(folder)])
    arm = core.Scene("so101", description)
    grey = np.full(4, 0.5)
    boxes = {each.name: each for each in scene.obstacles}
    for name, each in boxes.items():
        assert isinstance(each.shape, Box)
        arm.addBoxGeometry(
            name, "universe", core.Box(*each.shape.size.tolist()), each.T_base_obstacle.matrix, grey
        )
    if scene.floor_z is not None:
        below = np.eye(4)
        below[2, 3] = scene.floor_z - 0.5
        arm.addBoxGeometry(FLOOR, "universe", core.Box(4.0, 4.0, 1.0), below, grey)
        boxes[FLOOR] = None  # type: ignore[assignment]
    human = {part.replace("_", " "): link for link, part in so101_description.PARTS.items()}
    bodies = {**human, **{name: name for name in boxes}}
    checked = {frozenset(pair) for pair in CollisionModel(model, scene).pairs}
    wanted: dict[bool, list[tuple[str, str]]] = {True: [], False: []}
    order = list(bodies)
    for i, first in enumerate(order):
        for second in order[i + 1 :]:
            wanted[frozenset((first, second)) in checked].append((bodies[first], bodies[second]))
    for enable, pairs in wanted.items():
        arm.setCollisions(pairs, enable)
    return arm
