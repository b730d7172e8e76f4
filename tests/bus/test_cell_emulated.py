"""A cell of emulated arms: they set out together and keep apart, however they are moved."""

import re
from contextlib import ExitStack

import numpy as np
import pytest
from harness.emulated_pair import Arm, mirroring, swaying, teleop_bench
from harness.facing_arms import FAST, distance, in_time

from so101_motion.arm.cell import Cell
from so101_motion.common.clock import ManualClock
from so101_motion.common.geometry import SE3
from so101_motion.drivers.emulator.hand import Hand, parse_script
from so101_motion.planning.collision.apart import GUARDED
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.goals import JointGoal
from so101_motion.rig.simulated_rig import open_simulated

T_FAR = SE3.from_rpy((0.0, 0.0, np.pi), (0.9, 0.0, 0.0))

T_BESIDE = SE3.from_rpy((0.0, 0.0, -0.5 * np.pi), (0.25, 0.3, 0.0))
Q_BESIDE = np.radians([0.0, -40.0, 40.0, 60.0, 0.0])
"""An arm that reaches from the side to where another one points with its pan at -20 degrees."""

PHASE = 0.004
"""By how much the control cycles of the arms are apart [s]."""


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def arms(tmp_path, clock):
    opened = []
    try:
        for name in ("left", "right"):
            opened.append(Arm(tmp_path, name, clock, 2.0))
            clock.advance(PHASE)
        clock.advance(1.0)  # their weight is taken up
        yield opened
    finally:
        for arm in opened:
            arm.close()


def test_a_common_motion_begins_within_five_milliseconds(arms, clock):
    cell = Cell()
    for name, arm, T in zip(("left", "right"), arms, (SE3.identity(), T_FAR), strict=True):
        cell.add(name, arm.rig, T)
    begun = {}
    for k, arm in enumerate(arms):

        def note(state, k=k, q=arm.rig.arm.state.q_ref):
            if not np.array_equal(state.q_ref, q):
                begun.setdefault(k, state.t)

        arm.rig.executor.listen(note)
    goals = {name: JointGoal(q=np.full(5, 0.05)) for name in ("left", "right")}
    motions = cell.start_together(goals).values()
    while not all(each.future.done() for each in motions):
        if sum(each.plan is not None for each in motions) != 1:  # else the other is about to begin
            clock.advance(0.002)
    assert [motion.result() for motion in motions] == [None, None]
    assert abs(begun[0] - begun[1]) < 0.005


def true_distance(emulated, beside):
    """How far an emulated arm truly is from the one beside it [m]."""
    state = beside.arm.state
    q_beside = np.append(state.q_ref, state.q_jaw_ref)
    return distance(bodies_of(), np.radians(emulated.q_deg), q_beside, T_BESIDE)


def test_a_follower_of_teleoperation_stays_off_an_arm_beside_it(tmp_path):
    with ExitStack() as stack:
        bench = stack.enter_context(teleop_bench(tmp_path))
        beside = stack.enter_context(open_simulated(clock=bench.clock, q_start=Q_BESIDE))
        cell = Cell()
        cell.add("follower", bench.follower.rig, SE3.identity())
        cell.add("beside", beside, T_BESIDE)
        bench.start(guarded=True)
        bench.until(lambda: mirroring(bench))
        swaying(bench)  # to both sides, at 63 deg/s where it would meet the arm
        held, nearest, off = False, np.inf, 0.0
        for _ in range(140):
            bench.advance(0.05)
            held |= bool(bench.teleop.status.held_by)
            nearest = min(nearest, true_distance(bench.follower, beside))
            off = max(off, abs(bench.leader.q_deg[0] - bench.follower.q_deg[0]))
        assert mirroring(bench)
        assert held
        assert off > 15.0, "the leader went on where the follower could not"
        assert 0.5 * GUARDED < nearest < 2.0 * GUARDED
        assert bench.leader.q_deg[0] == pytest.approx(bench.follower.q_deg[0], abs=2.0)


@pytest.fixture
def beside(arms, clock):
    """A simulated arm beside the first, which a hand guides."""
    with open_simulated(clock=clock, q_start=Q_BESIDE) as beside:
        cell = Cell()
        cell.add("guided", arms[0].rig, SE3.identity())
        cell.add("beside", beside, T_BESIDE)
        in_time(clock, lambda: arms[0].rig.arm.set_manual(True))
        yield beside


def test_a_hand_is_held_back_before_it_leads_an_arm_into_another(arms, beside, clock):
    guided = arms[0]
    into, nearest = np.degrees(guided.world.q), np.inf
    into[0] = -28.0  # in contact
    guided.lead_to(into, 2.0)
    for _ in range(150):
        clock.advance(0.02)
        nearest = min(nearest, true_distance(guided, beside))
    assert np.degrees(guided.world.q[0]) < -10.0, "it was led"
    assert 0.0 < nearest < GUARDED


def test_an_arm_that_a_strong_hand_leads_into_another_says_what_it_touches(arms, beside, clock):
    guided = arms[0]
    assert guided.rig.arm.touching() == ""
    guided.emulator.advance()
    script = parse_script("0.1 shoulder_pan start\n2.1 shoulder_pan -25\n")
    guided.world.hand = Hand(script, clock.now(), strength=8.0)
    clock.advance(2.3)
    assert true_distance(guided, beside) < 0.0
    assert re.fullmatch("the .* close to beside's .*", guided.rig.arm.touching())


def test_an_arm_that_follows_targets_stays_off_one_that_a_hand_guides(arms, beside, clock):
    guided = arms[0]
    following = in_time(clock, lambda: beside.arm.follow(limits=FAST, stale_after=None, gate=10.0))
    reach, away = np.radians([0.0, 0.0, 10.0, 60.0, 0.0]), Q_BESIDE
    there, held, nearest = np.degrees(guided.world.q), set(), np.inf
    there[0] = 10.0
    guided.lead_to(there, 2.0)  # by hand, a little aside
    for k in range(600):
        following.aim(away if k < 250 else reach)
        clock.advance(0.01)
        held.update(following.held_by)
        if k % 3 == 0:
            nearest = min(nearest, true_distance(guided, beside))
    assert any("guided's" in each for each in held)
    assert 0.8 * GUARDED < nearest < 2.0 * GUARDED
    there[0] = 60.0
    guided.lead_to(there, 2.0)
    for _ in range(170):
        clock.advance(0.03)
        assert true_distance(guided, beside) > 0.8 * GUARDED
    assert following.held_by == ()
    np.testing.assert_allclose(beside.arm.state.q_ref, reach, atol=1e-6)
    following.close()
