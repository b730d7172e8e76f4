"""An episode of a LeRobot data set, replayed by emulated servos with weight and friction."""

import numpy as np
import pytest
from harness.facing_arms import in_time
from harness.lerobot_data import swing, write_data_set

from so101_motion.tasks.datasets import open_data_set, units_of
from so101_motion.tasks.datasets.replay import calibration_of, plan_episode, replay_episode


def from_rest(n=40):
    """A swing that begins slowly, shape (n, 6), in degrees."""
    action = swing(n)
    ease = np.sin(0.5 * np.pi * np.arange(n) / (n - 1)) ** 2
    return action[0] + (action - action[0]) * ease[:, None]


def test_servos_go_where_the_numbers_of_their_own_calibration_say(bench, tmp_path):
    rig = bench.open()
    rig.arm.set_speed(np.radians(180.0))
    rig.arm.set_acceleration(np.radians(500.0))
    bench.advance(1.0)
    units = units_of("degrees", calibration_of(rig))
    numbers = units.from_model(units_of("model").to_model(from_rest()))
    data_set = open_data_set(write_data_set(tmp_path / "set", [numbers]))
    replay = plan_episode(rig, data_set, 0, units=units)
    outcome = in_time(bench.clock, lambda: replay_episode(rig, replay), patience=0.002)
    assert bench.arm_deg(rig) == pytest.approx(from_rest()[-1, :5], abs=1.0)
    assert max(outcome.differences.rms_deg.values()) < 0.8
    assert outcome.differences.lag_s <= 0.12
    assert not outcome.held_by
