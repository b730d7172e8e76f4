"""The comparison with a recorded arm, where the emulated arm itself was recorded."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import bench_real_arm
from benchmarks.emulated_arm import ARMS, emulate_one

RECORDED = ARMS["7.4"]
RATE = 50.0
ZERO = np.array([23.0, 0.0, 0.0, 0.0, 0.0, 0.0]) * np.pi / 2048.0
"""How far the recorded calibration is off, in whole ticks [rad]."""


def goals(kind):
    """Steps of 13.8 deg and back, or a slow sine, of joints that carry nothing, shape (n, 6)."""
    t = np.arange(0.0, 8.0, 1.0 / RATE)
    q = np.zeros((len(t), 6))
    moved = np.radians(13.8) * (t % 4.0 >= 2.0) if kind == "steps" else 0.2 * np.sin(2.0 * t)
    q[:, [0, 4]] = moved[:, None]
    return {"t_cmd_s": t, "command": q, "t_s": t + 0.01, "position": np.zeros_like(q)}


@pytest.fixture(scope="module")
def recordings():
    """As the arm on record would have moved, with the zero of a calibration."""
    made = {}
    for kind in ("steps", "sine"):
        made[kind] = goals(kind)
        position = emulate_one(made[kind], RECORDED) + ZERO
        position[:, 5] = 0.0  # closed, as it was told
        made[kind]["position"] = position
    return made


def table(recordings, arm):
    # The zeros of these joints carry no weight, so it does not matter where they are.
    positions = [
        emulate_one({**each, "position": each["position"] - ZERO}, arm)
        for each in recordings.values()
    ]
    zero = bench_real_arm.zeros(list(recordings.values()), positions)
    return {row["what"]: row for row in bench_real_arm.figures(recordings, positions, zero)}


def test_the_arm_that_was_recorded_is_found_without_an_error_but_for_its_zero(recordings):
    found = table(recordings, RECORDED)
    assert found["error [rad]"]["arm"] < 3e-4  # it began elsewhere under its weight
    assert found["constant removed [deg]"]["shoulder_pan"] == pytest.approx(-23 * 360 / 4096)
    assert 0.02 < found["steps, 50% after [s], measured"]["shoulder_pan"] < 0.3
    assert found["lag of smooth motions [s], measured"]["wrist_roll"] > 0.0


def test_a_slower_arm_is_told_by_its_steps_and_its_lag(recordings):
    slower = replace(RECORDED, kind=replace(RECORDED.kind, goal_delay=0.05))
    found = table(recordings, slower)
    assert found["error [rad]"]["arm"] > 1e-3
    for what in ("steps, 5% after [s]", "lag of smooth motions [s]"):
        late = found[f"{what}, emulated"]["wrist_roll"] - found[f"{what}, measured"]["wrist_roll"]
        assert late == pytest.approx(0.05 - RECORDED.kind.goal_delay, abs=0.011), what
