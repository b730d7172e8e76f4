import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.emulator import parse_ids


def test_loop_with_a_load_falls_asleep_and_stays_where_it_is(make_bench, raised_arm):
    bench = make_bench(gravity=raised_arm)
    bench.write(2, reg.TORQUE_ENABLE, 1)
    bench.advance(2.0)
    assert bench.world.servo(2).drive.quiet
    before = bench.world.q[1]
    bench.advance(60.0)
    assert bench.world.q[1] == before


def test_held_load_warms_the_servo_while_nobody_looks(make_bench, raised_arm):
    bench = make_bench(gravity=raised_arm)
    bench.write(2, reg.TORQUE_ENABLE, 1)
    bench.advance(600.0)
    assert 26 <= bench.read(2, reg.PRESENT_TEMPERATURE) <= 35
    assert bench.read(1, reg.PRESENT_TEMPERATURE) == 25


def test_servos_are_found_by_joint_or_place_and_a_clock_that_goes_back_changes_nothing(bench):
    bench.advance(1.0)
    bench.world.advance(0.5)
    assert bench.world.t == pytest.approx(1.0)
    assert bench.world.servo("elbow_flex") is bench.world.servo(3) is bench.world.servo("3")
    with pytest.raises(ConfigError, match="elbow_flex"):
        bench.world.servo("knee")


@pytest.mark.parametrize(
    ("text", "ids"),
    [
        ("1-6", {1: 1, 2: 2, 3: 3, 4: 4, 5: 5, 6: 6}),
        ("1-2,5", {1: 1, 2: 2, 5: 5}),
        ("6=1", {6: 1}),
        ("1=1, 2=1", {1: 1, 2: 1}),
    ],
)
def test_ids_are_read_from_text(text, ids):
    assert parse_ids(text) == ids


@pytest.mark.parametrize("text", ["", "7", "0-3", "1=254", "a"])
def test_bad_ids_are_refused(text):
    with pytest.raises(ConfigError, match="ids"):
        parse_ids(text)


def test_new_servos_have_open_limits_and_finished_ones_their_stops(make_bench):
    new, finished = make_bench(calibrated=False), make_bench()
    assert [new.read(2, row) for row in (reg.MIN_POSITION, reg.MAX_POSITION)] == [0, 4095]
    ends = [finished.read(2, row) for row in (reg.MIN_POSITION, reg.MAX_POSITION)]
    assert ends == [round(2048 - 105.5 * 4096 / 360), round(2048 + 102.6 * 4096 / 360)]
