import math
from types import SimpleNamespace

import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.emulator import parse_ids


def test_resting_arm_is_not_computed(bench):
    steps = []
    bench.advance(1.0)
    for servo in bench.world.servos:
        assert servo.drive.quiet
        servo.drive.shaft = _counting(servo.drive.shaft, steps)
    bench.advance(3600.0)
    assert steps == []
    assert bench.world.t == pytest.approx(3601.0)


def _counting(shaft, steps):
    return SimpleNamespace(
        output=shaft.output,
        velocity=shaft.velocity,
        step=lambda *_, **__: steps.append(1),
    )


def test_what_wakes_one_servo_leaves_the_others_asleep(bench):
    bench.advance(1.0)
    bench.write(2, reg.GOAL_POSITION, 2200)
    assert [servo.drive.quiet for servo in bench.world.servos] == [True, False] + [True] * 4


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


def test_gravity_couples_the_joints(make_bench):
    import numpy as np

    def gravity(q):
        torque = np.zeros(6)
        torque[1] = -1.5 * math.cos(q[2])
        return torque

    bench = make_bench(gravity=gravity)
    for servo_id in (2, 3):
        bench.write(servo_id, reg.TORQUE_ENABLE, 1)
    bench.advance(1.0)
    loaded = bench.world.q[1]
    bench.write(3, reg.GOAL_POSITION, 2048 + 1000)
    bench.advance(2.0)
    assert bench.world.q[1] < loaded - 0.01


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


def test_places_left_out_are_not_on_the_bus(make_bench):
    bench = make_bench(ids={6: 1})
    assert bench.ask_one(1, 1).servo_id == 1
    assert bench.raw(b"\xff\xff\xfe\x02\x01\xfe") != []
    assert [bench.ask(i, 1) for i in range(2, 7)] == [[]] * 5


def test_new_servos_have_open_limits_and_finished_ones_their_stops(make_bench):
    new, finished = make_bench(calibrated=False), make_bench()
    assert [new.read(2, row) for row in (reg.MIN_POSITION, reg.MAX_POSITION)] == [0, 4095]
    ends = [finished.read(2, row) for row in (reg.MIN_POSITION, reg.MAX_POSITION)]
    assert ends == [round(2048 - 105.5 * 4096 / 360), round(2048 + 102.6 * 4096 / 360)]
