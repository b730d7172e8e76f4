"""Moves of the emulated arm, with its weight, friction and play, through a pseudo-terminal."""

import math

import numpy as np
import pytest

from so101_motion.common.modes import Mode
from so101_motion.drivers.emulator.hand import Hand, parse_script


@pytest.fixture
def bench(make_bench):
    """An arm whose answers are waited for as long as it takes, for none gets lost."""
    return make_bench(reply_timeout=2.0)


@pytest.fixture
def hasty(make_bench):
    return make_bench()


def goals(seed, count):
    rng = np.random.default_rng(seed)
    reach = np.array([1.5, 1.0, 1.0, 1.2, 2.0])
    return [rng.uniform(-1.0, 1.0, 5) * reach for _ in range(count)]


def test_moves_follow_their_path_and_end_within_the_tolerance(bench):
    for q_goal in goals(seed=1, count=5):
        bench.finish(bench.move(q_goal))
        error, lag = bench.driver.path_error()
        assert error < math.radians(3.0)
        assert lag < 0.15
        assert np.max(np.abs(bench.q - q_goal)) < math.radians(0.35)


@pytest.mark.parametrize("seed", [1, 2])
def test_moves_complete_on_a_bad_wire(hasty, seed):
    hasty.wire.loss, hasty.wire.corrupt = 0.05, 0.02
    for q_goal in goals(seed=seed, count=2):
        hasty.finish(hasty.move(q_goal))
        assert np.max(np.abs(hasty.q - q_goal)) < math.radians(0.35)
        assert hasty.driver.path_error()[0] < math.radians(3.0)
    assert sum(one.lost + one.corrupt for one in hasty.arm.health) > 50
    assert hasty.state.fault is None


@pytest.mark.parametrize("fault", ["late", "duplicate", "request_loss"])
def test_moves_complete_when_replies_or_requests_go_astray(hasty, fault):
    setattr(hasty.wire, fault, 0.05)
    (q_goal,) = goals(seed=3, count=1)
    hasty.finish(hasty.move(q_goal))
    assert np.max(np.abs(hasty.q - q_goal)) < math.radians(0.35)


def test_limp_joints_follow_the_hand_and_hold_where_they_are_left(bench):
    bench.finish(bench.executor.release())
    assert bench.state.mode is Mode.LIMP
    script = "0.1 shoulder_pan start\n0.9 shoulder_pan 20\n1.0 shoulder_pan release"
    bench.world.hand = Hand(parse_script(script), bench.clock.now())
    bench.clock.advance(1.5)
    moved = bench.q[0]
    bench.finish(bench.executor.hold())
    bench.clock.advance(1.0)
    assert moved == pytest.approx(math.radians(20.0), abs=0.05)
    assert bench.q[0] == pytest.approx(moved, abs=math.radians(1.0))


def test_an_answer_lost_at_that_moment_does_not_bring_a_limp_joint_back(bench):
    bench.finish(bench.executor.release())
    script = "0 shoulder_pan start\n0.5 shoulder_pan 40\n0.6 shoulder_pan release"
    bench.world.hand = Hand(parse_script(script), bench.clock.now())
    bench.clock.advance(0.34)  # last seen 40 ms ago
    bench.wire.lose_next = 6  # one reading of all servos
    here = bench.q[0]
    bench.finish(bench.executor.hold())
    assert bench.state.q_ref[0] == pytest.approx(here, abs=math.radians(0.35))
