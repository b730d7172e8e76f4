import pytest

from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.codec import Code
from so101_motion.drivers.emulator.electric import ROOM_C, Motor
from so101_motion.drivers.servo_types import STS3215_7V4, STS3215_12V

STALL = 200  # ticks into the jaw's stop: more than 80 % duty at P 32


@pytest.fixture
def stalled(bench):
    """A gripper that squeezes with all it has, just begun."""
    bench.write(6, reg.GOAL_POSITION, 2048)
    bench.advance(1.0)
    bench.world.put_object(0.015)
    bench.write(6, reg.MIN_POSITION, 0)
    bench.write(6, reg.GOAL_POSITION, 2048 - 3 * STALL)
    bench.advance(0.5)
    return bench


def test_overload_trips_after_its_time_and_sags_to_the_protective_torque(stalled):
    stalled.advance(1.4)
    assert stalled.read(6, reg.STATUS) == 0
    assert stalled.read(6, reg.PRESENT_LOAD) > 900
    stalled.advance(0.6)
    assert stalled.ask_one(6, Code.PING).error == reg.OVERLOAD
    assert stalled.read(6, reg.PRESENT_LOAD) == 200
    assert stalled.read(6, reg.TORQUE_ENABLE) == 1


def test_overloaded_servo_does_what_it_acknowledges_and_a_goal_pulled_back_clears_it(stalled):
    stalled.advance(2.0)
    assert stalled.write(6, reg.ACCELERATION, 33) == reg.OVERLOAD
    assert stalled.read(6, reg.ACCELERATION) == 33
    stalled.write(6, reg.GOAL_POSITION, stalled.read(6, reg.PRESENT_POSITION))
    stalled.advance(0.7)
    assert stalled.read(6, reg.STATUS) == 0
    assert stalled.read(6, reg.TORQUE_ENABLE) == 1


def test_torque_off_clears_an_overload(stalled):
    stalled.advance(2.0)
    stalled.write(6, reg.TORQUE_ENABLE, 0)
    stalled.advance(0.02)
    assert stalled.read(6, reg.STATUS) == 0


def test_moving_is_not_an_overload(make_bench, constant_load):
    bench = make_bench(gravity=constant_load(j1=-2.0))  # heavy, but it goes
    bench.write(1, reg.PROTECTION_TIME, 20)
    bench.write(1, reg.GOAL_POSITION, 700)
    errors = []
    for _ in range(20):
        bench.advance(0.05)
        if bench.world.q[0] > -1.5:
            errors.append(bench.read(1, reg.STATUS))
    assert len(errors) > 5
    assert not any(errors)


def test_overload_threshold_time_and_hold_are_registers(stalled):
    stalled.write(6, reg.TORQUE_ENABLE, 0)
    stalled.write(6, reg.OVERLOAD_TORQUE, 25)
    stalled.write(6, reg.PROTECTION_TIME, 10)
    stalled.write(6, reg.PROTECTIVE_TORQUE, 5)
    stalled.write(6, reg.GOAL_POSITION, 2048 - 3 * STALL)
    stalled.advance(0.5)
    assert stalled.read(6, reg.STATUS) == reg.OVERLOAD
    assert stalled.read(6, reg.PRESENT_LOAD) == 50


def test_unmasked_overload_is_reported_but_not_acted_upon(stalled):
    stalled.write(6, reg.UNLOADING, 0)
    stalled.write(6, reg.PROTECTION_CURRENT, 0)  # no limit
    stalled.advance(2.0)
    assert stalled.read(6, reg.STATUS) == reg.OVERLOAD
    assert stalled.read(6, reg.PRESENT_LOAD) > 900


def test_overcurrent_switches_torque_off_and_clears_when_switched_on(stalled):
    stalled.write(6, reg.TORQUE_ENABLE, 0)
    stalled.write(6, reg.PROTECTION_CURRENT, 150)  # about 1 A
    stalled.write(6, reg.OVERCURRENT_TIME, 50)
    stalled.write(6, reg.GOAL_POSITION, 2048 - 3 * STALL)
    stalled.advance(0.4)
    assert stalled.read(6, reg.STATUS) == 0
    stalled.advance(0.3)
    assert stalled.read(6, reg.STATUS) == reg.OVERCURRENT
    assert stalled.read(6, reg.TORQUE_ENABLE) == 0
    stalled.write(6, reg.TORQUE_ENABLE, 1)
    stalled.advance(0.02)
    assert stalled.read(6, reg.STATUS) == 0


def test_hot_servo_lets_go_until_five_degrees_cooler(make_bench, raised_arm):
    bench = make_bench(gravity=raised_arm)
    bench.write(2, reg.TORQUE_ENABLE, 1)
    bench.advance(0.5)
    held = bench.world.q[1]
    bench.world.warm("shoulder_lift", 71.0)
    bench.advance(0.04)
    assert bench.read(2, reg.STATUS) == 0
    bench.advance(0.5)
    assert bench.read(2, reg.STATUS) == reg.OVERHEATED
    assert bench.read(2, reg.PRESENT_TEMPERATURE) == 71
    assert bench.read(2, reg.TORQUE_ENABLE) == 1  # says so, but drives nothing
    assert bench.world.q[1] > held + 0.05
    bench.world.warm("shoulder_lift", 65.0)
    bench.advance(0.1)
    assert bench.read(2, reg.STATUS) == reg.OVERHEATED
    bench.world.warm("shoulder_lift", 64.0)
    bench.advance(0.1)
    assert bench.read(2, reg.STATUS) == 0
    sagged = bench.world.q[1]
    bench.advance(1.0)
    assert bench.world.q[1] == pytest.approx(sagged, abs=0.15)  # holds there, does not jump back


def test_voltage_is_reported_but_not_acted_upon_by_default(bench):
    bench.write(1, reg.TORQUE_ENABLE, 1)
    bench.world.power(14.6)
    bench.advance(0.04)
    assert bench.read(1, reg.STATUS) == 0
    bench.advance(0.04)
    assert bench.read(1, reg.STATUS) == reg.VOLTAGE_FAULT
    bench.write(1, reg.GOAL_POSITION, 2200)
    bench.advance(1.0)
    assert bench.read(1, reg.PRESENT_POSITION) == pytest.approx(2200, abs=3)
    bench.world.power(12.0)
    bench.advance(0.01)
    assert bench.read(1, reg.STATUS) == 0


def test_low_voltage_servos_on_twelve_volts_complain(make_bench):
    bench = make_bench(kind=STS3215_7V4, volts=12.1)
    bench.advance(0.1)
    assert {bench.read(i, reg.STATUS) for i in range(1, 7)} == {reg.VOLTAGE_FAULT}
    assert bench.read(1, reg.PRESENT_VOLTAGE) == 121


# Supply, heat and current


def test_a_motor_that_holds_or_stalls_has_its_temperature_and_its_current():
    motor = Motor(STS3215_12V)
    motor.advance(3600.0, duty=1.47 / STS3215_12V.torque_per_volt / 12.0, volts=12.0, velocity=0.0)
    assert motor.temperature == pytest.approx(48.0, abs=3.0)
    motor = Motor(STS3215_12V)
    motor.advance(0.001, duty=1.0, volts=12.0, velocity=0.0)
    assert motor.current == pytest.approx(2.95, abs=0.01)
    motor.temperature = 60.0
    motor.advance(150.0, duty=0.0, volts=12.0, velocity=0.0)
    assert motor.temperature == pytest.approx(ROOM_C + 35.0 / 2.718, abs=0.1)
