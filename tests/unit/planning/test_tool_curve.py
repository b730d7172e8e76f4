import numpy as np
import pytest

from so101_motion.geometry import SE3
from so101_motion.planning.arm_chain import ArmChain
from so101_motion.planning.model import RobotModel
from so101_motion.planning.path_geometry import JointPath
from so101_motion.planning.tool_curve import SMOOTH, TRUE, CurveFitter, Misfit, curve_through
from so101_motion.planning.tool_way import straight_way

READY = np.radians([0, -45, 45, 60, 20])
TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def model():
    return RobotModel.load()


@pytest.fixture(scope="module")
def chain(model):
    return ArmChain(model)


@pytest.fixture(scope="module")
def fitter(model, chain):
    return CurveFitter(chain, model.lower, model.upper, TOLERANCE)


@pytest.fixture(scope="module")
def way(model):
    T = model.frame(READY)
    return straight_way(T, SE3(T.R, T.p + np.array([0.02, 0.06, 0.03])))


def postures_on(model, way, s, pitches):
    """Postures on a way whose pitch is prescribed, by Newton's method on the model."""
    q, found = READY.copy(), []
    for p, pitch in zip(way.places(s), pitches, strict=True):
        for _ in range(20):
            J = np.zeros((5, 5))
            J[:3] = model.frame_jacobian(q)[:3]
            J[3, 1:4], J[4, 4] = 1.0, 1.0
            off = np.append(p - model.frame(q).p, [pitch - q[1:4].sum(), READY[4] - q[4]])
            q = q + np.linalg.solve(J, off)
        found.append(q)
    return np.array(found)


def accepts_all(curve):
    return None


def distance(chain, way, curve):
    s = np.linspace(0.0, curve.length, 501)
    return np.linalg.norm(chain.positions(curve.evaluate(s).q) - way.places(s), axis=1).max()


@pytest.mark.parametrize("stiffnesses", [SMOOTH, TRUE], ids=["smooth", "true"])
def test_the_tool_keeps_to_its_way_all_along_the_curve(model, chain, fitter, way, stiffnesses):
    s = np.linspace(0.0, way.length, 9)
    stairs = READY[1:4].sum() + 0.08 * np.floor(np.arange(9) / 3)
    q = postures_on(model, way, s, stairs)
    curve = fitter.fit(way, s, q, stiffnesses, accepts_all)
    assert isinstance(curve, JointPath)
    assert distance(chain, way, curve) < TOLERANCE
    assert np.array_equal(curve.evaluate([0.0]).q[0], q[0])
    assert curve.evaluate([way.length]).q[0] == pytest.approx(q[-1], abs=1e-6)


def test_steps_of_pitch_are_evened_out_where_nobody_asked_for_them(model, fitter, way):
    s = np.linspace(0.0, way.length, 9)
    stairs = READY[1:4].sum() + 0.08 * np.floor(np.arange(9) / 3)
    q = postures_on(model, way, s, stairs)

    def wobble(stiffnesses):
        curve = fitter.fit(way, s, q, stiffnesses, accepts_all)
        pitch = curve.evaluate(np.linspace(0.0, curve.length, 200)).q[:, 1:4].sum(axis=1)
        return np.abs(np.diff(pitch, 2)).max()

    assert wobble(SMOOTH) < 0.3 * wobble(TRUE)


def test_a_pitch_that_stays_is_left_alone(model, fitter, way):
    s = np.linspace(0.0, way.length, 9)
    q = postures_on(model, way, s, np.full(9, READY[1:4].sum()))
    curve = fitter.fit(way, s, q, SMOOTH, accepts_all)
    knots = curve.evaluate(curve.knots[:: (len(curve.knots) - 1) // 8]).q
    assert knots == pytest.approx(q, abs=1e-9)


def test_a_curve_that_is_not_accepted_is_tried_less_smooth_and_then_given_up(model, fitter, way):
    s = np.linspace(0.0, way.length, 9)
    q = postures_on(model, way, s, READY[1:4].sum() + 0.05 * np.array([0, 1, 0, 1, 0, 1, 0, 1, 0]))
    tried = []

    def refuse(curve):
        tried.append(curve)
        return Misfit(s=0.01, q=q[0], in_contact=True)

    assert fitter.fit(way, s, q, SMOOTH, refuse).in_contact
    assert len(tried) == len(SMOOTH)


def test_where_postures_are_not_one_motion_there_is_no_curve(model, fitter, way):
    s = np.linspace(0.0, way.length, 9)
    q = postures_on(model, way, s, np.full(9, READY[1:4].sum()))
    q[5:] = postures_on(model, way, s[5:], np.full(4, READY[1:4].sum() - 2.5))
    found = fitter.fit(way, s, np.clip(q, model.lower, model.upper), TRUE, accepts_all)
    assert isinstance(found, Misfit)
    assert s[4] < found.s < s[5]


def test_a_curve_does_not_bulge_over_a_joint_limit(model, chain):
    T = model.frame(READY)
    way = straight_way(T, SE3(T.R, T.p + np.array([0.05, 0.0, 0.0])))
    s = np.linspace(0.0, way.length, 9)
    q = postures_on(model, way, s, np.full(9, READY[1:4].sum()))
    tight = CurveFitter(chain, q.min(axis=0), q.max(axis=0), TOLERANCE)
    found = tight.fit(way, s, q, TRUE, accepts_all)
    assert isinstance(found, JointPath)
    inside = found.evaluate(np.linspace(0.0, found.length, 2001)).q
    assert np.all(inside >= q.min(axis=0) - 1e-6)
    assert np.all(inside <= q.max(axis=0) + 1e-6)


def test_the_curve_through_points_of_a_cubic_is_that_cubic():
    u = np.linspace(0.0, 1.0, 9)[:, None]
    factors = np.arange(1.0, 6.0)
    path = curve_through(factors * (u**3 - u**2) + u, 1.0)
    at = np.linspace(0.0, 1.0, 41)
    expected = factors * (at**3 - at**2)[:, None] + at[:, None]
    assert path.evaluate(at).q == pytest.approx(expected, abs=1e-12)
    slope = factors * (3.0 * at**2 - 2.0 * at)[:, None] + 1.0
    assert path.evaluate(at).q_s == pytest.approx(slope, abs=1e-10)
