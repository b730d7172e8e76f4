"""Answers that come late, or never, cost the control loop no cycle.

The loop, the driver and the bus are the real ones, on one clock that a test moves. Waiting for a
servo takes as long on it as it would in life: until the bus gives up, in whole milliseconds, as
``poll`` counts them.
"""

import math
import random
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from harness.retarget import retarget
from harness.servo_stand import MAPS, weightless

from so101_motion.common.errors import Interrupted
from so101_motion.control.executor import Executor, Tolerances
from so101_motion.drivers.bus.bus import Bus, reply_timeout_in
from so101_motion.drivers.bus.ticks import TICKS_PER_RAD
from so101_motion.drivers.feetech import gravity_compensation
from so101_motion.drivers.feetech.feetech_arm import FeetechArm
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits

STOP_LIMITS = MotionLimits.uniform(velocity=math.pi, acceleration=8.7, jerk=200.0)
LIMITS = MotionLimits.uniform(velocity=0.9, acceleration=1.7, jerk=50.0)
GOAL = np.array([0.8, 0.2, -0.2, 0.3, 0.5])
SYNC_READ, SYNC_WRITE = 0x82, 0x83


@pytest.fixture
def make_loop(wired, clock, monkeypatch):
    """Makes control loops with a period on a port that can be troubled; and closes them.

    The bus measures and waits on the same clock, so a busy machine changes nothing.
    """
    monkeypatch.setattr("so101_motion.drivers.bus.bus.time", SimpleNamespace(monotonic=clock.now))

    class WaitingPort(wired):
        """Hands answers over ``delay()`` [s] late. Who waits for them has lost that time."""

        waits, delay = False, None

        def __init__(self, **options):
            super().__init__(**options)
            self._coming = []

        def write(self, data):
            super().write(data)
            if self.delay and self._arrived:
                self._coming.append((clock.now() + self.delay(), self._arrived))
                self._arrived = b""

        def read(self, until):
            due = self._coming[0][0] if self._coming else math.inf
            wait_ms = math.ceil(1000.0 * (until - clock.now()) - 1e-6)
            if self.waits and not self._arrived and wait_ms > 0:
                give_up = clock.now() + wait_ms / 1000.0
                clock.wait(min(due, give_up), threading.Event())
            while self._coming and self._coming[0][0] <= clock.now():
                self._arrived += self._coming.pop(0)[1]
            return super().read(until)

    loops = []

    def make(dt):
        port = WaitingPort(now=clock.now)
        arm = FeetechArm(
            lambda: port, clock, MAPS, gravity=weightless, speed=math.pi,
            acceleration=10.0, reply_timeout=reply_timeout_in(dt),
        )  # fmt: skip
        tolerances = Tolerances(
            settle_position=gravity_compensation.SETTLE_POSITION,
            settle_velocity=gravity_compensation.SETTLE_VELOCITY,
            settle_timeout=gravity_compensation.SETTLE_TIMEOUT,
        )
        executor = Executor(
            arm, clock, dt=dt, stop_limits=STOP_LIMITS, tolerances=tolerances, name="so101-io-test"
        )
        executor.start()
        loops.append(executor)
        port.waits = True
        return port, executor

    yield make
    for executor in loops:
        executor.close()


def moved(clock, executor, dt):
    future = executor.execute(online.point_to_point(executor.state.q_ref, GOAL, LIMITS, dt))
    for _ in range(100):
        clock.advance(0.05)
        if future.done():
            break
    future.result(timeout=0)
    return executor.state


@pytest.mark.parametrize("dt", [0.01, 0.005])
@pytest.mark.parametrize("fault", ["late", "loss", "corrupt"])
def test_answers_that_come_late_or_never_cost_no_cycle(make_loop, clock, fault, dt):
    port, executor = make_loop(dt)
    setattr(port.faults, fault, 0.3)
    state = moved(clock, executor, dt)
    setattr(port.faults, fault, 0.0)
    assert state.late_ticks == 0
    clock.advance(0.5)
    np.testing.assert_allclose(port.world.q[:5], GOAL, atol=math.radians(0.6))


@pytest.mark.parametrize("dt", [0.01, 0.005])
def test_a_computer_that_hands_no_answer_over_for_a_while_costs_no_later_cycle(
    make_loop, clock, dt
):
    port, executor = make_loop(dt)
    future = executor.execute(online.point_to_point(executor.state.q_ref, GOAL, LIMITS, dt))
    clock.advance(0.4)
    port.faults.late = 1.0
    clock.advance(0.2)
    port.faults.late = 0.0
    clock.advance(0.1)
    meanwhile = executor.state.late_ticks
    clock.advance(3.0)
    future.result(timeout=0)
    assert meanwhile <= 0.2 / dt, "it may wait longer for answers meanwhile"
    assert executor.state.late_ticks == meanwhile


@pytest.mark.parametrize(("least", "most"), [(0, 0), (8, 8), (16, 16), (20, 20), (0, 20)])
def test_an_arm_whose_answers_come_late_keeps_its_cap_and_stops_as_soon(
    make_loop, clock, least, most
):
    """An adapter with a latency timer; ``least`` and ``most`` are in milliseconds."""
    port, executor = make_loop(0.01)
    rng = random.Random(45)
    port.delay = lambda: rng.uniform(least, most) / 1000.0
    cap = LIMITS.velocity[0] * TICKS_PER_RAD
    speeds, look = [], port.world._look

    def noted(dt):
        look(dt)
        speeds.append(max(abs(each.drive.shaft.velocity) for each in port.world.servos))

    port.world._look = noted
    moved(clock, executor, 0.01)
    np.testing.assert_allclose(port.world.q[:5], GOAL, atol=math.radians(0.6))
    assert max(speeds) < 1.06 * cap, "of the plan"
    futures = []
    for begin in (
        lambda: executor.execute(online.point_to_point(executor.state.q_ref, -GOAL, LIMITS, 0.01)),
        lambda: retarget(executor, GOAL, LIMITS),
    ):
        futures.append(begin())
        clock.advance(0.9)
        assert speeds[-1] > 0.2 * cap
        executor.stop()
        clock.advance(0.35)
        stopped = port.world.q
        clock.advance(1.0)
        np.testing.assert_allclose(port.world.q, stopped, atol=math.radians(0.6))
        assert isinstance(futures[-1].exception(timeout=0), Interrupted)
    assert max(speeds) < 1.06 * cap, "of the followed target"


def test_in_a_cycle_is_one_question_whatever_does_not_come(make_loop, clock):
    port, executor = make_loop(0.01)
    port.faults.loss = port.faults.late = 0.2
    port.sent.clear()
    moved(clock, executor, 0.01)
    kinds = [packet[4] for packet in port.sent]
    assert kinds.count(SYNC_READ) > 100
    assert not any(kinds[k] == kinds[k + 1] == SYNC_READ for k in range(100))
    assert set(kinds) == {SYNC_READ, SYNC_WRITE}


def test_who_answers_first_gives_the_others_no_more_time(port):
    """However the answers trickle in, the bus gives up when it would have anyway."""
    limits = []
    read = port.read

    def noted(until):
        limits.append(until)
        return read(until)

    port.read, port.chunk = noted, 1
    port.world.disconnect(6)
    Bus(port, reply_timeout=0.007).sync_read(range(1, 7), 56, 2)
    assert len(limits) > 5 * 8
    assert max(limits) == limits[0]


class FarAwayPort:
    """Six servos behind an adapter that hands over their answers ``delay`` [s] later.

    Time passes while an answer is waited for, and by ``wait``.
    """

    name, baud = "/dev/far", 1_000_000

    def __init__(self, wired):
        self._near, self._coming, self.now, self.delay = wired(), [], 0.0, 0.001

    def monotonic(self):
        return self.now

    def write(self, data):
        self._near.write(data)
        while reply := self._near.read(self.now):
            self._coming.append((self.now + self.delay, reply))

    def read(self, until):
        if self._coming and self._coming[0][0] <= max(until, self.now):
            due, reply = self._coming.pop(0)
            self.now = max(due, self.now)
            return reply
        self.now = max(until, self.now)
        return b""

    def discard(self):
        self._coming = [each for each in self._coming if each[0] > self.now]

    def close(self):
        """There is nothing to close."""


@pytest.mark.parametrize("delay", [0.004, 0.008, 0.016, 0.020, 0.040])
def test_answers_that_begin_to_come_late_are_late_not_lost_and_soon_waited_for(
    wired, monkeypatch, delay
):
    port = FarAwayPort(wired)
    monkeypatch.setattr("so101_motion.drivers.bus.bus.time", port)
    bus = Bus(port)
    found = []
    for cycle in range(100):
        port.delay = 0.001 if cycle < 30 else delay
        begin = port.now
        found.append(len(bus.sync_read(range(1, 7), 56, 15)))
        port.now = max(port.now, begin + 0.01)
    counted = bus.counters.values()
    assert found[50:] == [6] * 50
    assert sum(counter.lost + counter.corrupt for counter in counted) == 0
    assert sum(counter.late for counter in counted) == 600 - sum(found)
    assert bus.counters.lateness.typical == pytest.approx(delay, abs=0.002)
