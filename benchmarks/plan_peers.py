"""Two other planners on the same problems, if they are installed: OMPL and roboplan.

OMPL's RRT-Connect and simplifier call the very same posture check as ours. It looks at postures
0.05 rad apart; what lies between it does not know.

roboplan brings a collision model of its own, in C++ on Pinocchio and coal like ours: it gets the
same hulls, pairs, floor and obstacles, the hulls as surfaces, and keeps no margin. Its edges are
looked at every 0.05 rad, its paths shortened by its own shortcutting.

``pip install ompl==2.0.1 roboplan==0.7.0``; neither is a dependency.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import so101_description

from benchmarks.plan_problems import Problem
from so101_motion.common.geometry import Array
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import FLOOR, Box, Scene
from so101_motion.planning.kinematics.model import RobotModel

STEP = 0.05
"""Distance of the postures that peers look at on an edge [rad]."""

TIME = 10.0
"""When they give up [s]."""

Prepare = Callable[[int, Problem], Callable[[], Array | None]]
"""From a seed and a problem to a search, set up and ready to go: waypoints, shape (m, 5), [rad]."""


def ompl_search(model: RobotModel, scene: Scene) -> Prepare | None:
    """OMPL's RRT-Connect and simplifier under our posture check, or None if not installed."""
    try:
        base: Any = importlib.import_module("ompl.base")
        geometric: Any = importlib.import_module("ompl.geometric")
        util: Any = importlib.import_module("ompl.util")
    except ImportError:
        return None
    util.setLogLevel(util.LogLevel.LOG_NONE)
    collision = CollisionModel(model, scene)
    space = base.RealVectorStateSpace(5)
    bounds = base.RealVectorBounds(5)
    for i, (lower, upper) in enumerate(model.limits):
        bounds.setLow(i, lower)
        bounds.setHigh(i, upper)
    space.setBounds(bounds)

    def prepare(seed: int, problem: Problem) -> Callable[[], Array | None]:
        setup = geometric.SimpleSetup(space)
        setup.setStateValidityChecker(lambda state: collision.is_free([state[i] for i in range(5)]))
        information = setup.getSpaceInformation()
        information.setStateValidityCheckingResolution(STEP / space.getMaximumExtent())
        setup.setPlanner(geometric.RRTConnect(information))
        ends = [space.allocState(), space.allocState()]
        for state, q in zip(ends, problem, strict=True):
            for i in range(5):
                state[i] = float(q[i])
        setup.setStartAndGoalStates(*ends)
        setup.setup()

        def attempt() -> Array | None:
            if not setup.solve(TIME):
                return None
            setup.simplifySolution()
            states = setup.getSolutionPath().getStates()
            return np.array([[state[i] for i in range(5)] for state in states])

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

    def prepare(seed: int, problem: Problem) -> Callable[[], Array | None]:
        planner = rrt.RRT(arm, options)
        planner.setRngSeed(seed + 1)
        start, goal = (core.JointConfiguration(names, q) for q in problem)
        shortening = core.PathShortcuttingOptions(max_step_size=STEP, seed=seed)
        shortcutter = core.PathShortcutter(arm, shortening)

        def attempt() -> Array | None:
            try:
                path = planner.plan(start, goal)
            except RuntimeError:
                return None
            return np.array(shortcutter.shortcut(path).positions)

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
