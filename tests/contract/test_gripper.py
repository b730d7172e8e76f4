"""What every gripper promises, beside its arm."""

import numpy as np
import pytest
from harness.emulated_rig import near

from so101_motion.common.errors import ConfigError, Interrupted
from so101_motion.control.executor import Channel


def test_the_jaw_opens_as_far_as_it_is_told_and_closes(bench, rig):
    bench.finish(rig.gripper.move(0.8, wait=False))
    assert rig.gripper.aperture == pytest.approx(0.8, abs=0.02)
    bench.finish(rig.gripper.grab(wait=False))
    bench.advance(1.0)
    assert rig.gripper.aperture < 0.05
    assert not rig.gripper.is_holding
    with pytest.raises(ConfigError, match="aperture"):
        rig.gripper.move(1.5, wait=False)


def test_a_newer_motion_of_the_jaw_ends_the_older_one(bench, rig):
    bench.finish(rig.gripper.grab(wait=False))
    first = rig.gripper.move(0.9, wait=False)
    bench.advance(0.2)
    bench.finish(rig.gripper.move(0.2, wait=False))
    with pytest.raises(Interrupted, match="a newer motion"):
        bench.finish(first)
    assert rig.gripper.aperture == pytest.approx(0.2, abs=0.02)


def test_a_stop_of_the_jaw_leaves_it_where_it_is_and_the_arm_alone(bench, rig):
    goal = near(rig, 1, 0, 0, 0, 0)
    arm = bench.go(rig, *goal)
    bench.finish(rig.gripper.grab(wait=False))
    jaw = rig.gripper.move(0.9, wait=False)
    bench.advance(0.2)
    bench.finish(rig.executor.stop(Channel.JAW))
    with pytest.raises(Interrupted, match="stop"):
        bench.finish(jaw)
    bench.finish(arm)
    stands = rig.gripper.aperture
    bench.advance(1.0)
    assert 0.01 < stands < 0.88
    assert rig.gripper.aperture == pytest.approx(stands, abs=0.02)
    assert np.array(bench.arm_deg(rig)) == pytest.approx(goal, abs=0.35)


@pytest.mark.emulator_only
def test_what_the_jaw_closes_on_is_held_until_the_jaw_opens_or_it_is_taken_away(bench, rig):
    for opens in (True, False):
        bench.finish(rig.gripper.move(0.8, wait=False))
        bench.put_between_the_jaws()
        bench.finish(rig.gripper.grab(wait=False))
        bench.advance(1.5)
        assert rig.gripper.is_holding
        if opens:
            opening = rig.gripper.move(0.9, wait=False)
            assert not rig.gripper.is_holding
            bench.take_away()
            bench.finish(opening)
        else:
            bench.take_away()
            bench.advance(1.0)
        assert not rig.gripper.is_holding
