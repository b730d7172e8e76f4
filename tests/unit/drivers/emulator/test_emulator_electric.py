import pytest

from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.codec import Code
from so101_motion.drivers.emulator.electric import ROOM_C, Motor
from so101_motion.drivers.servo_types import STS3215_12V


def test_supply_sags_while_many_joints_pull(make_bench, constant_load):
    bench = make_bench(gravity=constant_load(**{f"j{n}": 4.5 for n in range(1, 7)}))
    resting = bench.read(1, reg.PRESENT_VOLTAGE)
    for servo_id in range(1, 7):
        bench.write(servo_id, reg.TORQUE_ENABLE, 1)
    bench.advance(0.4)
    assert resting == 120
    assert 105 <= bench.read(1, reg.PRESENT_VOLTAGE) <= 116


def test_brown_out_reboots_every_servo(bench):
    for servo_id in range(1, 7):
        bench.write(servo_id, reg.TORQUE_ENABLE, 1)
    bench.world.power(3.0)
    bench.advance(0.1)
    assert all(bench.ask(i, Code.PING) == [] for i in range(1, 7))
    bench.world.power(12.0)
    bench.advance(0.5)
    assert bench.ask(1, Code.PING) == []
    bench.advance(0.5)
    assert [bench.read(i, reg.TORQUE_ENABLE) for i in range(1, 7)] == [0] * 6


def test_weak_supply_is_shown_and_slows_the_arm(bench):
    bench.world.power(6.0)
    bench.write(1, reg.GOAL_POSITION, 3400)
    bench.advance(0.6)
    assert bench.read(1, reg.PRESENT_VOLTAGE) in (58, 59, 60)
    assert bench.read(1, reg.PRESENT_VELOCITY) < 1600


def test_unplugged_servo_is_silent_and_limp_and_comes_back_rebooted(bench):
    bench.write(3, reg.TORQUE_ENABLE, 1)
    bench.world.disconnect("elbow_flex")
    assert bench.ask(3, Code.PING) == []
    assert len(bench.ask(4, Code.PING)) == 1
    bench.world.connect("elbow_flex")
    bench.advance(1.0)
    assert bench.read(3, reg.TORQUE_ENABLE) == 0


def test_a_torque_of_one_and_a_half_newton_metres_is_held_at_forty_eight_degrees():
    motor = Motor(STS3215_12V)
    motor.advance(3600.0, duty=1.47 / STS3215_12V.torque_per_volt / 12.0, volts=12.0, velocity=0.0)
    assert motor.temperature == pytest.approx(48.0, abs=3.0)


def test_resting_servo_cools_to_room_temperature():
    motor = Motor(STS3215_12V)
    motor.temperature = 60.0
    motor.advance(150.0, duty=0.0, volts=12.0, velocity=0.0)
    assert motor.temperature == pytest.approx(ROOM_C + 35.0 / 2.718, abs=0.1)


def test_stalled_motor_draws_its_stall_current():
    motor = Motor(STS3215_12V)
    motor.advance(0.001, duty=1.0, volts=12.0, velocity=0.0)
    assert motor.current == pytest.approx(2.95, abs=0.01)
