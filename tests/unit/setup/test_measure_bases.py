"""A hand makes the tips of two simulated arms touch; the other base's pose is measured."""

import threading
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack

import numpy as np
import pytest

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
from so101_motion.setup.base_fit import TIP, measure_bases

T_LEFT_RIGHT = SE3.from_rpy((0.0, 0.0, 3.05), (0.36, 0.015, 0.0))
"""Where the right arm really stands."""

PLACES = np.array(
    [
        [0.2, 0.05, 0.1],
        [0.16, -0.06, 0.14],
        [0.18, 0.0, 0.2],
        [0.2, -0.05, 0.08],
        [0.17, 0.07, 0.17],
    ]
)


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
        with ThreadPoolExecutor(1) as pool:
            done = pool.submit(lambda: measure_bases(self.arms, len(PLACES), touch))
            while not wait([done], timeout=0.0005).done:
                self.clock.advance(0.01)
        return done.result()


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
