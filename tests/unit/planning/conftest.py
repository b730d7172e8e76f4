"""The arm, the checks of an empty scene and the planner, which all of the tests here may share."""

import pytest

from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.kinematics.geometry_from_model import measure_structure
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner


@pytest.fixture(scope="session")
def model():
    return RobotModel.load()


@pytest.fixture(scope="session")
def collision(model):
    return CollisionModel(model)


@pytest.fixture(scope="session")
def planner(model):
    return Planner(model)


@pytest.fixture(scope="session")
def solver(model):
    return IkSolver(model)


@pytest.fixture(scope="session")
def structure(model):
    return measure_structure(model)
