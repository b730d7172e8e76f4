import numpy as np
import pytest

from so101_motion.common.geometry import SE3
from so101_motion.planning.cartesian.curve_fit import (
    EXACT,
    SMOOTHED,
    CurveFitter,
    FitFailure,
    curve_through,
)
from so101_motion.planning.cartesian.tool_path import straight_path
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.timing.path_geometry import JointPath

READY = np.radians([0, -45, 45, 60, 20])
TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def chain(model):
    return ArmChain(model)


@pytest.fixture(scope="module")
def fitter(model, chain):
    return CurveFitter(chain, model.lower, model.upper, TOLERANCE)


@pytest.fixture(scope="module")
def tool_path(model):
    T = model.frame(READY)
    return straight_path(T, SE3(T.R, T.p + np.array([0.02, 0.06, 0.03])))


def configurations_on(model, tool_path, s, pitches):
    """Configurations on a path whose pitch is prescribed, by Newton's method on the model."""
    q, found = READY.copy(), []
    for p, pitch in zip(tool_path.places(s), pitches, strict=True):
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


def distance(chain, tool_path, curve):
    s = np.linspace(0.0, curve.length, 501)
    return np.linalg.norm(chain.positions(curve.evaluate(s).q) - tool_path.places(s), axis=1).max()


@pytest.mark.parametrize("stiffnesses", [SMOOTHED, EXACT], ids=["smooth", "true"])
def test_the_tool_keeps_to_its_path_all_along_the_curve(
    model, chain, fitter, tool_path, stiffnesses
):
    s = np.linspace(0.0, tool_path.length, 9)
    stairs = READY[1:4].sum() + 0.08 * np.floor(np.arange(9) / 3)
    q = configurations_on(model, tool_path, s, stairs)
    curve = fitter.fit(tool_path, s, q, stiffnesses, accepts_all)
    assert isinstance(curve, JointPath)
    assert distance(chain, tool_path, curve) < TOLERANCE
    assert np.array_equal(curve.evaluate([0.0]).q[0], q[0])
    assert curve.evaluate([tool_path.length]).q[0] == pytest.approx(q[-1], abs=1e-6)


def test_steps_of_pitch_are_evened_out_where_nobody_asked_for_them(model, fitter, tool_path):
    s = np.linspace(0.0, tool_path.length, 9)
    stairs = READY[1:4].sum() + 0.08 * np.floor(np.arange(9) / 3)
    q = configurations_on(model, tool_path, s, stairs)

    def wobble(stiffnesses):
        curve = fitter.fit(tool_path, s, q, stiffnesses, accepts_all)
        pitch = curve.evaluate(np.linspace(0.0, curve.length, 200)).q[:, 1:4].sum(axis=1)
        return np.abs(np.diff(pitch, 2)).max()

    assert wobble(SMOOTHED) < 0.3 * wobble(EXACT)


def test_a_pitch_that_stays_is_left_alone(model, fitter, tool_path):
    s = np.linspace(0.0, tool_path.length, 9)
    q = configurations_on(model, tool_path, s, np.full(9, READY[1:4].sum()))
    curve = fitter.fit(tool_path, s, q, SMOOTHED, accepts_all)
    knots = curve.evaluate(curve.knots[:: (len(curve.knots) - 1) // 8]).q
    assert knots == pytest.approx(q, abs=1e-9)


def test_a_curve_that_is_not_accepted_is_tried_less_smooth_and_then_given_up(
    model, fitter, tool_path
):
    s = np.linspace(0.0, tool_path.length, 9)
    q = configurations_on(
        model, tool_path, s, READY[1:4].sum() + 0.05 * np.array([0, 1, 0, 1, 0, 1, 0, 1, 0])
    )
    tried = []

    def refuse(curve):
        tried.append(curve)
        return FitFailure(s=0.01, q=q[0], in_contact=True)

    assert fitter.fit(tool_path, s, q, SMOOTHED, refuse).in_contact
    assert len(tried) == len(SMOOTHED)


def test_where_postures_are_not_one_motion_there_is_no_curve(model, fitter, tool_path):
    s = np.linspace(0.0, tool_path.length, 9)
    q = configurations_on(model, tool_path, s, np.full(9, READY[1:4].sum()))
    q[5:] = configurations_on(model, tool_path, s[5:], np.full(4, READY[1:4].sum() - 2.5))
    found = fitter.fit(tool_path, s, np.clip(q, model.lower, model.upper), EXACT, accepts_all)
    assert isinstance(found, FitFailure)
    assert s[4] < found.s < s[5]


def test_a_curve_does_not_bulge_over_a_joint_limit(model, chain):
    T = model.frame(READY)
    tool_path = straight_path(T, SE3(T.R, T.p + np.array([0.05, 0.0, 0.0])))
    s = np.linspace(0.0, tool_path.length, 9)
    q = configurations_on(model, tool_path, s, np.full(9, READY[1:4].sum()))
    tight = CurveFitter(chain, q.min(axis=0), q.max(axis=0), TOLERANCE)
    found = tight.fit(tool_path, s, q, EXACT, accepts_all)
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
