"""The pose of a base, computed from points that two tips have touched."""

import numpy as np
import pytest

from so101_motion.common.errors import CalibrationError
from so101_motion.common.geometry import SE3
from so101_motion.setup.base_fit import FEWEST, fit_base

T_FIRST_SECOND = SE3.from_rpy((0.02, -0.01, 3.1), (0.35, 0.012, -0.003))


def touches(count, noise, seed=0):
    """Places between two arms in the frame of each, off by as much as hands are [m]."""
    random = np.random.default_rng(seed)
    p_first = np.array([0.17, 0.0, 0.12]) + random.uniform(-0.08, 0.08, (count, 3))
    off = noise * random.standard_normal((count, 3))
    p_second = np.array([T_FIRST_SECOND.inverse @ p for p in p_first + off])
    return p_first, p_second


def test_exact_touches_give_the_exact_base():
    fit = fit_base(*touches(5, 0.0))
    np.testing.assert_allclose(fit.T_first_second.p, T_FIRST_SECOND.p, atol=1e-12)
    np.testing.assert_allclose(fit.T_first_second.R, T_FIRST_SECOND.R, atol=1e-12)
    assert fit.rms < 1e-12


def test_touches_of_a_millimetre_give_the_base_to_a_few():
    worst = 0.0
    for seed in range(20):
        fit = fit_base(*touches(8, 0.001, seed))
        middle = np.array([0.17, 0.0, 0.12])
        there = fit.T_first_second @ (T_FIRST_SECOND.inverse @ middle)
        worst = max(worst, float(np.linalg.norm(there - middle)))
        assert 0.0 < fit.rms < 0.003
    assert worst < 0.002


def test_a_touch_that_does_not_fit_is_named():
    p_first, p_second = touches(7, 0.0005)
    p_second[3] += [0.0, 0.03, 0.0]
    with pytest.raises(CalibrationError, match="touch 4 of 7"):
        fit_base(p_first, p_second)


def test_touches_along_a_line_are_refused():
    p_first = np.array([0.17, 0.0, 0.05]) + np.outer(np.arange(6), [0.0, 0.0, 0.03])
    p_second = np.array([T_FIRST_SECOND.inverse @ p for p in p_first])
    with pytest.raises(CalibrationError, match="one line"):
        fit_base(p_first, p_second)


def test_too_few_touches_are_refused():
    p_first, p_second = touches(FEWEST - 1, 0.0)
    with pytest.raises(CalibrationError, match="too few"):
        fit_base(p_first, p_second)
    with pytest.raises(ValueError, match="5 places"):
        fit_base(touches(5, 0.0)[0], p_second)
