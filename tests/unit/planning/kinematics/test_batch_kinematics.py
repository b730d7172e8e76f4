import numpy as np
import pytest

from so101_motion.common.geometry import SE3
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.model import RobotModel

T_TOOL_PEN = SE3.from_rpy((0.3, -0.2, 0.1), (0.02, -0.03, 0.12))


@pytest.fixture(scope="module")
def model():
    return RobotModel.load().with_frame("pen", T_TOOL_PEN)


@pytest.fixture(scope="module")
def q(model):
    return np.random.default_rng(0).uniform(model.lower, model.upper, (40, 5))


@pytest.mark.parametrize("frame", ["tool", "jaw_tip", "pen"])
def test_many_postures_at_once_are_what_the_model_says_of_each(model, q, frame):
    chain = ArmChain(model, frame)
    p, J = chain.positions_and_jacobians(q)
    R = chain.rotations(q)
    for k, configuration in enumerate(q):
        T = model.frame(configuration, frame)
        assert p[k] == pytest.approx(T.p, abs=1e-14)
        assert R[k] == pytest.approx(T.R, abs=1e-14)
        assert J[k] == pytest.approx(model.frame_jacobian(configuration, frame)[:3], abs=1e-14)
    assert chain.positions(q) == pytest.approx(p, abs=1e-15)


def test_speeds_are_those_of_the_jacobian(model, q):
    chain = ArmChain(model)
    qd = np.random.default_rng(1).standard_normal(q.shape)
    _, J = chain.positions_and_jacobians(q)
    expected = np.linalg.norm(np.einsum("nij,nj->ni", J, qd), axis=1)
    assert chain.speeds(q, qd) == pytest.approx(expected, abs=1e-14)
