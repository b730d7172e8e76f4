"""The pose of a base, computed from points that two tips have touched."""

import threading
from contextlib import ExitStack

import numpy as np
import pytest
from harness.facing_arms import in_time

from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import CalibrationError
from so101_motion.common.geometry import SE3
from so101_motion.common.modes import Mode
from so101_motion.drivers.simulated import SimArm
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import PoseGoal
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.rig import Rig
from so101_motion.setup.base_fit import FEWEST, TIP, fit_base, measure_bases

T_FIRST_SECOND = SE3.from_rpy((0.02, -0.01, 3.1), (0.35, 0.012, -0.003))


def touches(count, noise, seed=0):
    """Places between two arms in the frame of each, off by as much as hands are [m]."""
    random = np.random.default_rng(seed)
    p_first = np.array([0.17, 0.0, 0.12]) + random.uniform(-0.08, 0.08, (count, 3))
    off = noise * random.standard_normal((count, 3))
    p_second = np.array([T_FIRST_SECOND.inverse @ p for p in p_first + off])
    return p_first, p_second


def test_exact_touches_give_the_exact_base_and_those_of_a_millimetre_give_it_to_a_few():
    fit = fit_base(*touches(5, 0.0))
    np.testing.assert_allclose(fit.T_first_second.p, T_FIRST_SECOND.p, atol=1e-12)
    np.testing.assert_allclose(fit.T_first_second.R, T_FIRST_SECOND.R, atol=1e-12)
    assert fit.rms < 1e-12
    worst = 0.0
    for seed in range(20):
        fit = fit_base(*touches(8, 0.001, seed))
        middle = np.array([0.17, 0.0, 0.12])
        there = fit.T_first_second @ (T_FIRST_SECOND.inverse @ middle)
        worst = max(worst, float(np.linalg.norm(there - middle)))
        assert 0.0 < fit.rms < 0.003
    assert worst < 0.002


def test_a_touch_that_does_not_fit_is_named_and_too_few_or_those_along_a_line_are_refused():
    p_first, p_second = touches(7, 0.0005)
    p_second[3] += [0.0, 0.03, 0.0]
    with pytest.raises(CalibrationError, match="touch 4 of 7"):
        fit_base(p_first, p_second)
    p_first = np.array([0.17, 0.0, 0.05]) + np.outer(np.arange(6), [0.0, 0.0, 0.03])
    p_second = np.array([T_FIRST_SECOND.inverse @ p for p in p_first])
    with pytest.raises(CalibrationError, match="one line"):
        fit_base(p_first, p_second)
    p_first, p_second = touches(FEWEST - 1, 0.0)
    with pytest.raises(CalibrationError, match="too few"):
        fit_base(p_first, p_second)
    with pytest.raises(ValueError, match="5 places"):
        fit_base(touches(5, 0.0)[0], p_second)


T_LEFT_RIGHT = SE3.from_rpy((0.0, 0.0, 3.05), (0.36, 0.015, 0.0))
"""Where the right arm really stands."""

PLACES = np.array([
    [0.2, 0.05, 0.1], [0.16, -0.06, 0.14], [0.18, 0.0, 0.2], [0.2, -0.05, 0.08], [0.17, 0.07, 0.17],
])  # fmt: skip


class Hands:
    """A person who brings the tips of two simulated arms together, to a millimetre."""

    def __init__(self, stack):
        self.clock, self.arms, self._joints = ManualClock(), {}, {}
        self._random, model, zero = np.random.default_rng(1), RobotModel.load(), np.zeros(5)
        T_tool_jaw_tip = model.frame(zero).inverse @ model.frame(zero, "jaw_tip")
        T_tool_tip = T_tool_jaw_tip @ SE3.from_translation((0.0, 0.0, TIP))
        self._ik = IkSolver(model.with_frame("tip", T_tool_tip))
        for name in ("left", "right"):
            self._joints[name] = SimArm(self.clock)
            rig = Rig(
                self._joints[name], clock=self.clock, speed=1.0, acceleration=2.0, scene=Scene()
            )
            self.arms[name] = stack.enter_context(rig).arm

    def touch(self, p, off=(0.0, 0.0, 0.0)):
        p_right = T_LEFT_RIGHT.inverse @ (p + off + self._random.normal(0.0, 0.0005, 3))
        for name, p_tip in (("left", p), ("right", p_right)):
            goal = PoseGoal.at_point(p_tip, frame="tip")
            self._joints[name].push(self._ik.solve(goal, np.zeros(5)).q)
        with self.clock.attend():
            self.clock.wait(self.clock.now() + 0.05, threading.Event())

    def measure(self, touch):
        """What is measured while time passes."""
        return in_time(
            self.clock, lambda: measure_bases(self.arms, len(PLACES), touch), patience=0.0005
        )


@pytest.fixture
def hands():
    with ExitStack() as stack:
        yield Hands(stack)


def test_the_other_base_is_found_and_what_does_not_fit_is_refused(hands):
    fits = hands.measure(lambda _, __, number: hands.touch(PLACES[number - 1]))
    [(name, fit)] = fits.items()
    assert name == "right"
    assert 0.0 < fit.residuals.max() < 0.002
    middle = PLACES.mean(axis=0)
    found = fit.T_first_second @ (T_LEFT_RIGHT.inverse @ middle)
    assert np.linalg.norm(found - middle) < 0.002

    def careless(_, __, number):
        hands.touch(PLACES[number - 1], off=(0.0, 0.025 * (number == 3), 0.0))

    with pytest.raises(CalibrationError, match=r"does not fit the others by \d+\.\d mm \(6 mm at"):
        hands.measure(careless)
    assert all(arm.state.mode is Mode.HOLDING for arm in hands.arms.values())
