"""Faults of an arm on hardware: which error is raised, what keeps running, and how it ends."""

import math

import numpy as np
import pytest

from so101_motion.common.modes import Mode
from so101_motion.drivers.emulator.faults import parse_fault


def usable_again(bench):
    bench.finish(bench.executor.hold())
    bench.finish(bench.move([0.2, 0.0, 0.0, 0.0, 0.0]))
    assert np.max(np.abs(bench.q - [0.2, 0.0, 0.0, 0.0, 0.0])) < math.radians(0.35)


def test_a_port_that_is_somebody_elses_after_the_replug_is_waited_for(bench):
    bench.emulator.unplug()
    bench.clock.advance(0.5)
    assert "went away" in bench.state.fault or "no such port" in bench.state.fault
    bench.clock.advance(20.0)
    assert not bench.arm.is_connected
    bench.emulator.plug()
    bench.clock.advance(5.1)
    assert bench.arm.is_connected
    usable_again(bench)


def test_a_hot_servo_is_reported_and_nothing_else_is_lost(bench):
    bench.world.warm("wrist_roll", 66.0)
    bench.finish(bench.move([0.3, 0.0, 0.0, 0.0, 0.0]))
    hot = bench.arm.health[4]
    assert (hot.joint, hot.temperature_c, hot.faults) == ("wrist_roll", 66, ())
    bench.world.warm("wrist_roll", 75.0)
    bench.clock.advance(0.5)
    assert bench.arm.health[4].faults == ("overheated",)
    assert bench.state.mode is Mode.HOLDING


def test_a_weak_supply_shows_in_the_voltage(bench):
    bench.world.power(5.5)
    bench.clock.advance(0.5)
    assert all(one.volts == pytest.approx(5.4, abs=0.3) for one in bench.arm.health)


def test_garbage_of_two_servos_with_one_id_is_counted(bench):
    bench.world.servos[1].drive.shaft.output += 40.0
    bench.emulator.begin(parse_fault("twin:2=1"))
    bench.clock.advance(2.0)
    assert bench.state.fault is not None
    bench.emulator.end(parse_fault("twin:2=1"))
    bench.clock.advance(2.0)
    usable_again(bench)
