"""Faults in teleoperation: the leader, the follower, a servo or a moment of answers is lost."""

import numpy as np
import pytest
from harness.emulated_pair import (
    PERIOD,
    mirroring,
    setpoints,
    swaying,
    teleop_bench,
    waiting,
    zeros,
)

from so101_motion.tasks.teleop.predictor import Predictor


@pytest.fixture
def bench(tmp_path, planning_process):
    with teleop_bench(tmp_path) as bench:
        yield bench


@pytest.fixture
def impatient(tmp_path, planning_process):
    """Every answer that gets lost costs a test as much time as an answer is waited for."""
    with teleop_bench(tmp_path, reply_timeout=0.015) as bench:
        yield bench


def silence(arm):
    for place in range(1, 7):
        arm.world.disconnect(place)


def speak(arm):
    for place in range(1, 7):
        arm.world.connect(place)


LOSSES = {
    "unplugged": (lambda arm: arm.emulator.unplug(), lambda arm: arm.emulator.plug()),
    "silent": (silence, speak),
    "one servo": (lambda arm: arm.world.disconnect(3), lambda arm: arm.world.connect(3)),
}


@pytest.mark.parametrize("loss", LOSSES)
def test_a_lost_leader_makes_the_follower_hold_within_100_ms(impatient, loss):
    bench = impatient
    lose, find = LOSSES[loss]
    bench.start()
    bench.advance(0.3)
    swaying(bench)
    bench.advance(2.2)  # it passes the middle at full speed
    lost = bench.clock.now()
    lose(bench.leader)
    bench.until(lambda: waiting(bench))
    assert bench.clock.now() - lost <= (0.03 if loss == "unplugged" else 0.07)
    bench.advance(0.5)

    _, q, qd = setpoints(bench, lost)
    speed = np.abs(qd[:, 0])
    assert np.all(np.diff(speed[8:]) <= 0.01), (
        "after 0.09 s, when the delay of 22 ms shows, it only gets slower"
    )
    assert speed[30:].max() < 0.01
    assert np.abs(bench.follower.rig.arm.state.qd).max() < np.radians(4.0)

    bench.leader.lead_to([-40.0, -20.0, 0.0, 0.0, 0.0, 20.0], 0.1)
    bench.advance(0.5)
    find(bench.leader)
    bench.advance(1.5)
    assert waiting(bench)
    assert setpoints(bench)[1][-1] == pytest.approx(q[-1], abs=0.01)
    assert bench.teleop.status.leader_is_limp

    bench.leader.lead_to([*setpoints(bench)[1][-1] - zeros(bench), 20.0], 1.0)
    bench.advance(2.5)
    assert mirroring(bench)
    assert np.abs(setpoints(bench, lost + 1.0)[2]).max() < 60.0


def test_after_a_moment_without_news_of_the_leader_the_follower_catches_up(bench, monkeypatch):
    bench.start()
    bench.advance(0.3)
    swaying(bench)
    bench.advance(1.9)
    lost = bench.clock.now()
    with monkeypatch.context() as busy:
        busy.setattr(Predictor, "take", lambda *_: None)
        bench.advance(0.12)
        assert waiting(bench)
    bench.until(lambda: mirroring(bench), at_most=0.02)
    bench.advance(0.5)
    qd = setpoints(bench, lost)[2]
    assert np.abs(np.diff(qd, axis=0)).max() <= 6.1, "its cap is 600 deg/s^2"
    off = bench.leader.q_deg[:5] - bench.follower.q_deg[:5]
    assert np.abs(off).max() <= 1.5, "it is with the leader again"
    assert bench.teleop.status.last_error == ""


def test_a_new_start_brings_the_follower_to_a_leader_that_came_back(bench):
    bench.start()
    bench.advance(0.3)
    bench.leader.emulator.unplug()
    bench.until(lambda: waiting(bench))
    bench.leader.lead_to([-40.0, -20.0, 0.0, 0.0, 0.0, 20.0], 0.2)
    bench.advance(1.0)
    bench.leader.emulator.plug()
    bench.advance(1.5)
    assert waiting(bench)
    again = bench.clock.now()
    bench.run(bench.teleop.stop)
    bench.run(bench.teleop.start)
    bench.until(lambda: mirroring(bench))
    assert np.abs(setpoints(bench, again)[2]).max() <= 30.1


@pytest.mark.parametrize("loss", ["unplugged", "silent"])
def test_a_lost_follower_comes_to_rest_and_goes_on_only_through_the_gate(impatient, loss):
    bench = impatient
    lose, find = LOSSES[loss]
    bench.start()
    bench.advance(0.3)
    swaying(bench)
    bench.advance(2.2)
    lose(bench.follower)
    speeds = []
    for _ in range(60):
        before = bench.follower.q_deg[0]
        bench.advance(PERIOD)
        speeds.append(abs(bench.follower.q_deg[0] - before) / PERIOD)
    assert waiting(bench)
    assert max(speeds[10:]) < speeds[0], "it has begun to brake"
    assert max(speeds[40:]) < 25.0, "a joint without power rolls out"
    assert bench.teleop.status.consecutive_errors > 30
    assert bench.teleop.status.last_error

    bench.leader.lead_to([-40.0, -20.0, 0.0, 0.0, 0.0, 20.0], 0.1)
    bench.advance(0.5)
    find(bench.follower)
    bench.advance(1.5)
    where = bench.follower.q_deg
    assert waiting(bench)
    bench.leader.lead_to([*where[:5] - zeros(bench), 20.0], 1.0)
    bench.advance(3.0)
    assert mirroring(bench)
    assert bench.teleop.status.consecutive_errors == 0
