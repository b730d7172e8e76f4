"""Two simulated arms hand over an object, on a clock the test drives."""

from contextlib import ExitStack

import numpy as np
import pytest
from harness.facing_arms import T_LEFT_RIGHT, FacingArms

from so101_motion.common.errors import ConfigError, Interrupted, MotionError
from so101_motion.planning.cell.grasps import grasps_of
from so101_motion.planning.cell.handover import JawGeometry
from so101_motion.planning.collision.apart import GUARDED, clearance_over_time
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.course import Course
from so101_motion.planning.collision.scene import Attached, Box, Scene
from so101_motion.planning.kinematics.model import RobotModel

pytestmark = pytest.mark.usefixtures("planning_process")

STICK = Box(size=[0.02, 0.02, 0.16])


class Bench(FacingArms):
    """The left arm holds a stick at one end."""

    def __init__(self, stack):
        jaw = JawGeometry(RobotModel.load())
        held = next(e for e in grasps_of(STICK) if abs(e.T_object_grip.p[2]) > 0.06)
        T_tool_object = jaw.T_tool_grip(held.thickness) @ held.T_object_grip.inverse
        self.stick = Attached(name="stick", shape=STICK, T_tool_object=T_tool_object, mass=0.04)
        super().__init__(stack, scene=Scene(attached=(self.stick,)))

    def held(self, name):
        return [each.name for each in self.arms[name].scene.attached]

    def clearance(self):
        """How near the arms are to each other, without what they hold [m]."""
        courses = [
            (bodies_of(), Course.resting(each.state.q_ref, each.state.q_jaw))
            for each in self.arms.values()
        ]
        return clearance_over_time(*courses, T_LEFT_RIGHT, np.zeros(1))[0].distance

    def p_stick(self, name):
        """Where the middle of the stick is in the left arm's base frame [m]."""
        [held] = self.arms[name].scene.attached
        return self.cell.members[name].T_cell_base @ (
            self.arms[name].model.frame(self.arms[name].state.q_ref) @ held.T_tool_object.p
        )

    def finish(self, motions, until=lambda: False):
        def look():
            assert self.clearance() > 0.7 * GUARDED

        self.pass_time([each.future for each in motions.values()], until, look)


@pytest.fixture
def bench():
    with ExitStack() as stack:
        yield Bench(stack)


def test_a_stick_goes_from_hand_to_hand_with_its_shape_and_weight(bench):
    plan = bench.cell.plan_handover("left", "right", "stick")
    motions = bench.cell.start_handover(plan)
    bench.finish(motions, until=lambda: bench.held("right") == ["stick"])
    assert bench.held("left") == ["stick"], "both hold it"
    np.testing.assert_allclose(bench.p_stick("left"), bench.p_stick("right"), atol=1e-6)
    where = bench.p_stick("right")
    bench.finish(motions)
    for motion in motions.values():
        motion.result()
    assert bench.held("left") == []
    [taken] = bench.arms["right"].scene.attached
    assert (taken.mass, taken.passed_to) == (0.04, "")
    np.testing.assert_array_equal(taken.shape.size, STICK.size)
    np.testing.assert_allclose(bench.p_stick("right"), where, atol=1e-6)

    # And back again: nothing is left over from the first time.
    back = bench.cell.start_handover(bench.cell.plan_handover("right", "left", "stick"))
    bench.finish(back)
    for motion in back.values():
        motion.result()
    assert (bench.held("left"), bench.held("right")) == (["stick"], [])


def test_stopping_one_arm_ends_the_handover_and_the_stick_stays_where_it_is(bench):
    motions = bench.cell.start_handover(bench.cell.plan_handover("left", "right", "stick"))
    bench.finish(motions, until=lambda: bench.arms["right"].is_moving)
    for _ in range(20):
        bench.clock.advance(0.01)
    bench.arms["right"].start_stop()
    bench.finish(motions)
    for motion in motions.values():
        with pytest.raises(Interrupted):
            motion.result()
    assert (bench.held("left"), bench.held("right")) == (["stick"], [])


def test_a_hand_that_closes_on_nothing_takes_nothing(bench):
    plan = bench.cell.plan_handover("left", "right", "stick")
    bench.cell.members["right"].gripper.feels = True  # as a real one, and there is no stick
    motions = bench.cell.start_handover(plan)
    bench.finish(motions)
    with pytest.raises(MotionError, match=r"'stick' cannot be passed .* left still holds it"):
        motions["right"].result()
    with pytest.raises(Interrupted):
        motions["left"].result()
    assert (bench.held("left"), bench.held("right")) == (["stick"], [])


def test_an_object_that_was_lost_is_not_passed_on(bench):
    plan = bench.cell.plan_handover("left", "right", "stick")
    bench.arms["left"].scene = Scene()
    with pytest.raises(ConfigError, match=r"'stick' is not in the hand of left"):
        bench.cell.start_handover(plan)
