"""One emulated arm leads, another follows: real rigs, servos with weight, friction and play."""

import numpy as np
import pytest
from harness.emulated_pair import (
    PERIOD,
    best_shift,
    human_motion,
    mirroring,
    setpoints,
    shifts,
    swaying,
    teleop_bench,
    waiting,
    zeros,
)

from so101_motion.common.errors import PortUnavailable
from so101_motion.common.modes import Mode
from so101_motion.planning.collision.scene import Scene
from so101_motion.tasks.teleop import Mirror
from so101_motion.tasks.teleop.pilot import Phase


@pytest.fixture
def bench(tmp_path, planning_process):
    with teleop_bench(tmp_path) as bench:
        yield bench


@pytest.fixture
def impatient(tmp_path, planning_process):
    """Every answer that gets lost costs a test as much time as an answer is waited for."""
    with teleop_bench(tmp_path, reply_timeout=0.015) as bench:
        yield bench


def at(bench, *degrees):
    """A hand leads the leader to these angles, without the follower, before anything has begun."""
    bench.run(lambda: bench.leader.rig.arm.set_manual(True))
    bench.leader.lead_to(degrees, 1.5)
    bench.clock.advance(2.5)


# Following


def test_the_follower_is_10_ms_behind_a_person_and_within_a_degree(bench):
    bench.start()
    bench.advance(0.5)
    bench.leader.lead(human_motion(7.5, seed=3))
    bench.advance(1.5)
    rows = []
    for _ in range(550):
        bench.clock.advance(PERIOD)
        rows.append((bench.leader.q_deg, bench.follower.q_deg))
    leader, follower = (np.array(side) for side in zip(*rows, strict=True))

    shift, error = best_shift(leader[:, :5], follower[:, :5], PERIOD)
    each = shifts(leader[:, :5], follower[:, :5], PERIOD, window=2.0)
    assert 0.0 <= shift <= 0.013
    assert error <= 1.55, "play of 0.85 deg and the friction of leader and follower are in it"
    assert np.median(each) <= 0.013
    assert np.percentile(each, 95.0) <= 0.035
    assert best_shift(leader[:, 5:], follower[:, 5:], PERIOD)[1] < 4.0, "the jaw comes along"
    assert mirroring(bench)
    assert bench.teleop.status.last_error == ""


def test_a_shoulder_that_follows_as_hard_as_it_can_swings_past_by_no_more_than_it_may(bench):
    bench.start()
    bench.advance(0.5)
    way = human_motion(61.5, seed=2, fastest=180.0)[2200:2700]  # its hardest turns are at 25 s
    bench.leader.lead_to(way[0], 1.5)
    bench.advance(2.0)
    bench.leader.lead(way)
    bench.advance(2.5)
    strays = []
    for _ in range(200):
        bench.clock.advance(PERIOD)
        wanted = np.degrees(bench.follower.rig.arm.state.q_ref)
        strays.append(np.abs(wanted - bench.follower.q_deg[:5]).max())
    assert mirroring(bench)
    assert max(strays) < 7.5, "a joint that is 8 deg off has lost its setpoints"


# Where it ends


def test_the_follower_waits_at_its_limit_and_says_so(bench):
    lower, upper = np.degrees(bench.follower.rig.arm.range)
    bench.start(mirror=Mirror(factors=[1.0, 1.0, 1.0, 1.0, 2.0]))
    bench.advance(0.3)
    begin = bench.clock.now()
    swaying(bench, "wrist_roll", amplitude=100.0, period=8.0)
    bench.advance(2.3)
    assert bench.teleop.status.beyond == ("wrist_roll",)
    assert bench.follower.q_deg[4] == pytest.approx(upper[4], abs=1.5)
    bench.advance(2.0)
    _, q, qd = setpoints(bench, begin)
    assert q[:, 4].max() <= upper[4] + 0.02
    assert q[:, 4].min() >= lower[4] - 0.02
    assert np.abs(qd).max() <= 180.5
    assert mirroring(bench)


def test_the_guard_stops_short_of_the_table_and_lets_go_when_the_leader_comes_back(bench):
    at(bench, 0.0, -10.0, 20.0, 60.0, 0.0, 20.0)
    bench.follower.rig.arm.scene = Scene(floor_z=0.02)
    bench.start(guarded=True)
    bench.until(lambda: mirroring(bench))
    bench.leader.lead_to([0.0, 35.0, 20.0, 60.0, 0.0, 20.0], 1.5)
    bench.until(lambda: any("close to the floor" in e for e in bench.teleop.status.held_by))
    held = bench.follower.rig.arm.state.q_ref
    bench.advance(1.5)
    assert bench.follower.rig.arm.T_base("jaw_tip").p[2] > 0.02
    assert bench.teleop.status.held_by
    assert np.degrees(np.abs(bench.follower.rig.arm.state.q_ref - held)).max() < 20.0, "it slides"

    begin = bench.clock.now()
    bench.leader.lead_to([0.0, -10.0, 20.0, 60.0, 0.0, 20.0], 1.5)
    bench.advance(3.5)
    assert mirroring(bench)
    bench.until(lambda: not bench.teleop.status.held_by)
    assert bench.follower.q_deg == pytest.approx(bench.leader.q_deg, abs=2.0)
    assert np.abs(setpoints(bench, begin)[2]).max() < 100.0


def test_a_follower_that_cannot_be_moved_is_reported_at_once(bench):
    bench.follower.emulator.unplug()
    bench.clock.advance(0.2)
    with pytest.raises(PortUnavailable, match="check the USB cable"):
        bench.start()
    assert bench.teleop.status.phase is Phase.STOPPED
    assert bench.leader.rig.arm.state.mode is Mode.HOLDING
    bench.follower.emulator.plug()
    bench.clock.advance(1.0)


# The jaw


def test_what_the_jaw_closes_on_is_gripped_and_let_go_of(bench):
    bench.leader.lead_to([*np.degrees(bench.leader.world.q[:5]), 60.0], 0.5)
    bench.start()
    bench.leader.lead_to([*np.degrees(bench.leader.world.q[:5]), 60.0], 1.0)
    bench.advance(2.0)
    assert bench.follower.q_deg[5] > 45.0
    bench.follower.world.put_object(0.03)
    bench.leader.lead_to([*np.degrees(bench.leader.world.q[:5]), 0.0], 0.8)
    bench.until(lambda: bench.teleop.status.is_gripping)
    bench.advance(1.0)
    assert bench.teleop.status.is_gripping
    assert mirroring(bench)
    load = next(j.load for j in bench.follower.rig.servos.health if j.joint == "gripper")
    assert 0.05 < abs(load) < 0.45
    bench.leader.lead_to([*np.degrees(bench.leader.world.q[:5]), 60.0], 0.8)
    bench.advance(3.0)
    assert not bench.teleop.status.is_gripping
    assert bench.follower.q_deg[5] > 45.0


# Faults: the leader, the follower, a servo or a moment of answers is lost


LOSSES = {
    "unplugged": (lambda arm: arm.emulator.unplug(), lambda arm: arm.emulator.plug()),
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


def test_a_lost_follower_comes_to_rest_and_goes_on_only_through_the_gate(impatient):
    bench = impatient
    bench.start()
    bench.advance(0.3)
    swaying(bench)
    bench.advance(2.2)
    bench.follower.emulator.unplug()
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
    bench.follower.emulator.plug()
    bench.advance(1.5)
    where = bench.follower.q_deg
    assert waiting(bench)
    bench.leader.lead_to([*where[:5] - zeros(bench), 20.0], 1.0)
    bench.advance(3.0)
    assert mirroring(bench)
    assert bench.teleop.status.consecutive_errors == 0
