import math
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.protocol import instruction_packet
from so101_motion.drivers.bus.ticks import RAD_PER_TICK, JointMap, Ticks
from so101_motion.drivers.feetech.gravity_compensation import SETTLE_VELOCITY
from so101_motion.drivers.feetech.joint_estimate import WINDOW, JointEstimate
from so101_motion.drivers.goal_limiter import SIX

PAN, LIFT = 0, 1
TWO = {PAN: JointMap(servo_id=7), LIFT: JointMap(servo_id=8)}


@pytest.fixture
def at():
    """Two joints of six, with servos 7 and 8."""
    return JointEstimate(TWO)


def seen(at, q, wanted, now=0.0):
    """Both joints answer that they are there [rad]."""
    at.answered[:2], at.fresh = [JointMap(servo_id=7).to_ticks(q)] * 2, 0b11
    at.look(wanted, now)


def unseen(at, wanted, now):
    """No joint answers."""
    at.fresh = 0
    at.look(wanted, now)


def sent(*q):
    return SIX(*q, math.nan, math.nan, math.nan, math.nan)


NOWHERE = sent(math.nan, math.nan)


def test_joints_are_where_their_servos_say_and_one_that_is_not_seen_follows_its_goals(at):
    seen(at, 0.5, NOWHERE)
    assert at.q[:] == pytest.approx([0.5, 0.5, 0.0, 0.0, 0.0, 0.0], abs=RAD_PER_TICK)
    assert JointMap(servo_id=8).to_rad(at.ticks(LIFT)) == at.q[LIFT]
    seen(at, 0.48, sent(0.5, 0.5))
    unseen(at, sent(0.7, 0.5), 0.01)
    assert at.q[PAN] == pytest.approx(0.68, abs=RAD_PER_TICK)
    assert at.q[LIFT] == pytest.approx(0.48, abs=RAD_PER_TICK)


def test_a_joint_sent_nowhere_or_told_to_stay_where_it_was_pushed_is_where_it_was_seen(at):
    seen(at, 0.3, sent(math.nan, 0.9))
    unseen(at, sent(0.9, math.nan), 0.01)
    assert at.q[:2] == pytest.approx([0.3, 0.3], abs=RAD_PER_TICK)
    seen(at, 0.3, sent(0.0, 0.0))
    for wanted in (0.3, 0.2):
        unseen(at, sent(wanted, wanted), 0.01)
        assert at.q[:2] == pytest.approx([0.3, 0.3], abs=RAD_PER_TICK)


def test_a_servo_that_was_set_up_anew_is_where_it_was_found(at):
    seen(at, 0.3, sent(0.0, 0.0))
    at.found(PAN, Ticks(2048), 0.0)
    unseen(at, sent(0.5, 0.5), 0.01)
    assert at.q[PAN] == 0.0


def test_velocities_are_slopes_and_begin_anew_after_a_gap(at):
    for k in range(10):
        seen(at, 0.1 * k, NOWHERE, 0.1 * k)
    assert at.qd[:2] == pytest.approx([1.0, 1.0], abs=0.02)
    at.forget()
    seen(at, 0.0, NOWHERE, 9.0)
    assert at.qd[:] == [0.0] * 6


# Velocities


def pushed(at, q, period):
    """The velocities of the pan [rad/s] while it is seen at ``q`` [rad], one by one."""
    found = []
    for k, each in enumerate(q):
        seen(at, each, NOWHERE, period * k)
        found.append(at.qd[PAN])
    return np.array(found)


def test_a_stop_is_seen_within_the_window_and_a_second_reading_at_once_is_no_movement(at):
    seen(at, 0.2, NOWHERE)
    assert at.qd[:] == [0.0] * 6
    seen(at, 0.3, NOWHERE)
    assert at.qd[:] == [0.0] * 6
    speeds = pushed(at, 0.01 * np.minimum(np.arange(100), 50), 0.01)
    assert speeds[49] == pytest.approx(1.0, abs=0.02)
    assert abs(speeds[61]) < 1e-9


def test_scatter_of_a_resting_encoder_stays_below_what_counts_as_rest(at):
    scatter = np.random.default_rng(1).integers(-1, 2, 2000) * RAD_PER_TICK
    assert np.percentile(np.abs(pushed(at, scatter, 0.01))[20:], 99) < SETTLE_VELOCITY


@pytest.mark.parametrize("period", [0.0005, 0.01, 2.0 * WINDOW])
def test_a_steady_movement_has_its_velocity_however_often_it_is_measured(at, period):
    speeds = pushed(at, -0.5 * period * np.arange(round(10 + 0.5 / period)), period)
    assert speeds[-1] == pytest.approx(-0.5, abs=0.02)


def answering(ticks, **faults):
    """A bus on which the servos 7 and 8 answer that they are there, once."""
    received = b"".join(
        instruction_packet(i, faults.get(f"of_{i}", 0), reg.PRESENT_POSITION.encode(each))
        for i, each in zip((7, 8), ticks, strict=False)  # an answer looks like an instruction
    )
    return SimpleNamespace(ask=lambda answers, *_: (answers.begin(2), answers.feed(received)))


def test_plain_answers_do_at_once_what_others_do_in_steps(at, clock):
    stepwise, wanted = JointEstimate(TWO), sent(0.1, 0.2)
    for i, each in product(TWO, (at, stepwise)):
        each.found(i, Ticks(2048), 0.0)
    for ticks in np.random.default_rng(1).integers(2046, 2051, (20, 2)).tolist():
        assert at.ask(answering(ticks), 2, (), clock, plainly=(wanted, None)) == ({}, None)
        found, doubted = stepwise.ask(answering(ticks), 2, (), clock)
        stepwise.look(wanted, clock.now())
        assert (found.keys(), doubted) == ({7, 8}, ())
        for name in ("q", "qd", "sure"):
            np.testing.assert_array_equal(getattr(at, name)[:], getattr(stepwise, name)[:])
        assert at.unsure == stepwise.unsure
        clock.advance(0.01)
    assert at.unsure == 0


@pytest.mark.parametrize(
    ("ticks", "faults", "doubted"),
    [([2048], {}, []), ([2048, 2048], {"of_8": 32}, []), ([2048, 4095], {}, [8])],
)
def test_answers_that_lack_doubt_or_report_something_are_left_to_be_looked_at(
    at, clock, ticks, faults, doubted
):
    seen(at, 0.0, NOWHERE)
    at.found(LIFT, Ticks(2048), 0.0)
    found, still = at.ask(answering(ticks, **faults), 2, (), clock, plainly=(NOWHERE, None))
    assert found.keys() == {7, 8}.intersection((7, 8)[: len(ticks)]) - {*doubted}
    assert still == (doubted or ())


def test_a_first_position_that_no_encoder_has_is_not_believed(at, clock):
    answer = instruction_packet(7, 0, b"\xff\x7f")  # one of a servo looks the same
    bus = SimpleNamespace(ask=lambda answers, *_: (answers.begin(2), answers.feed(answer)))
    assert at.ask(bus, 2, (), clock) == ({}, [7])
