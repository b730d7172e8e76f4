"""The emulated servo's other modes: at a speed, at a duty, by steps."""

import pytest

from so101_motion.drivers.emulator import registers as reg

ROLL = 5  # turns freely through most of a turn


def in_mode(bench, mode):
    bench.write(ROLL, reg.LOCK, 0)
    bench.write(ROLL, reg.MODE, mode)


def position(bench):
    return bench.read(ROLL, reg.PRESENT_POSITION)


@pytest.mark.parametrize("speed", [400, -400])
def test_in_speed_mode_it_turns_as_fast_as_it_is_told_and_stops(bench, speed):
    in_mode(bench, reg.SPEED_MODE)
    bench.write(ROLL, reg.ACCELERATION, 50)
    bench.write(ROLL, reg.GOAL_VELOCITY, speed)
    assert bench.read(ROLL, reg.TORQUE_ENABLE) == 1
    bench.advance(1.0)
    begin = position(bench)
    assert bench.read(ROLL, reg.PRESENT_VELOCITY) == pytest.approx(speed, abs=50)
    assert bench.read(ROLL, reg.MOVING) == 1
    bench.advance(1.0)
    assert position(bench) - begin == pytest.approx(speed, rel=0.05)
    bench.write(ROLL, reg.GOAL_VELOCITY, 0)
    bench.advance(1.0)
    stopped = position(bench)
    bench.advance(1.0)
    assert position(bench) == pytest.approx(stopped, abs=1)
    assert bench.read(ROLL, reg.MOVING) == 0


def test_in_step_mode_a_goal_is_so_much_farther(bench):
    in_mode(bench, reg.STEP_MODE)
    begin = position(bench)
    for _ in range(2):
        bench.write(ROLL, reg.GOAL_POSITION, 100)
        bench.advance(1.0)
    assert position(bench) - begin == pytest.approx(200, abs=10)
    bench.write(ROLL, reg.MAX_POSITION, begin + 250)
    bench.write(ROLL, reg.GOAL_POSITION, 100)
    bench.advance(1.0)
    assert position(bench) - begin == pytest.approx(250, abs=10), "clamped like any goal"
