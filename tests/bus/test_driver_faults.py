"""Faults of an arm on hardware: which error is raised, what keeps running, and how it ends."""

import math

import numpy as np
import pytest

from so101_motion.common.errors import NotHolding, PortUnavailable
from so101_motion.common.modes import Mode
from so101_motion.drivers.emulator.faults import parse_fault

HALF = math.radians(0.5)
GOAL = [1.2, 0.2, -0.2, 0.0, 0.5]


def moved_since(bench, seconds, q_from):
    """How far the joints get from ``q_from`` while time passes [rad]."""
    worst = 0.0
    for _ in range(round(seconds / 0.05)):
        bench.clock.advance(0.05)
        worst = max(worst, float(np.max(np.abs(bench.q - q_from))))
    return worst


def usable_again(bench):
    bench.finish(bench.executor.hold())
    bench.finish(bench.move([0.2, 0.0, 0.0, 0.0, 0.0]))
    assert np.max(np.abs(bench.q - [0.2, 0.0, 0.0, 0.0, 0.0])) < math.radians(0.35)


def test_unplugged_in_mid_move_and_replugged_two_seconds_later(bench):
    future = bench.move(GOAL)
    bench.clock.advance(0.7)
    bench.emulator.unplug()
    bench.clock.advance(0.5)
    with pytest.raises(PortUnavailable, match="went away"):
        future.result(timeout=0)
    assert bench.state.mode is Mode.FAULT
    where = bench.q
    assert moved_since(bench, 1.5, where) < HALF
    bench.emulator.plug()
    took = 0.0
    while not bench.arm.is_connected:
        bench.clock.advance(0.05)
        took += 0.05
        assert took < 3.0
    assert moved_since(bench, 1.0, where) < HALF
    with pytest.raises(NotHolding):
        bench.finish(bench.move(GOAL))
    bench.finish(bench.executor.hold())
    assert moved_since(bench, 1.0, where) < HALF
    usable_again(bench)


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
