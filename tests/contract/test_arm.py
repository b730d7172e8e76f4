"""What every arm promises, whatever moves it: simulated, emulated servos, a module elsewhere.

With ``--hardware PORT`` also a real arm: it moves by 10 deg at most from where it stands, at
15 deg/s, its jaw all the way. ``tests/module/test_contract_process.py`` tries a few of these on an
arm of a real module process.
"""

import numpy as np
import pytest
from harness.emulated_rig import STEP_DEG, near
from harness.path_following import follow, random_plan

from so101_motion.common.errors import Interrupted, MotionError, OutsideLimits
from so101_motion.common.modes import Mode
from so101_motion.planning.goals import JointGoal

SLOW = np.radians(5.0)
"""A speed at which a step takes longer than a second and a half."""


def place(bench, rig):
    """Where the joints are [deg]."""
    return np.array(bench.arm_deg(rig))


def send(rig, degrees):
    """Begin a move that has yet to be planned."""
    return rig.arm.move(JointGoal(q=np.radians(degrees)), wait=False)


def stays(bench, rig, seconds=1.0):
    """The arm holds, and is where it was a moment ago."""
    here = place(bench, rig)
    bench.advance(seconds)
    assert not rig.arm.state.arm_moving
    assert rig.arm.state.mode is Mode.HOLDING
    assert place(bench, rig) == pytest.approx(here, abs=0.7)
    return here


def test_opening_an_arm_and_planning_for_it_moves_nothing(bench, rig):
    before = place(bench, rig)
    rig.arm.plan(JointGoal(q=np.radians(near(rig, 1, 0, 0, 0, 0))))
    assert stays(bench, rig) == pytest.approx(before, abs=0.5)


def test_an_arm_on_servos_moves_neither_when_it_is_closed_nor_when_it_is_opened_again(on_servos):
    before = place(on_servos, on_servos.rig)
    on_servos.shut(on_servos.rig)
    assert stays(on_servos, on_servos.open()) == pytest.approx(before, abs=0.5)


def test_every_servo_says_how_it_is(on_servos):
    on_servos.advance(0.5)
    health = on_servos.rig.servos.health
    assert [one.joint for one in health] == [*on_servos.rig.servos.setups]
    for one in health:
        assert 4.0 < one.volts < 14.5
        assert 5 < one.temperature_c < 60
        assert one.faults == ()
        assert not one.is_silent
        assert one.answers > 10
        assert one.lost + one.corrupt < 0.05 * one.answers


def test_a_move_carries_out_the_very_plan_it_was_given_and_ends_at_its_goal(bench, rig):
    start = np.degrees(rig.arm.state.q)
    for goal in (near(rig, 1, 0, 0, 0.5, 1), start):
        plan = rig.arm.plan(JointGoal(q=np.radians(goal)))
        motion = rig.arm.move(plan, wait=False)
        bench.finish(motion)
        assert motion.plan is plan
        assert stays(bench, rig) == pytest.approx(goal, abs=0.35)


def test_a_plan_that_starts_elsewhere_is_refused(bench, rig):
    plan = rig.arm.plan(JointGoal(q=np.radians(near(rig, 0.5, 0, 0, 0, 0))))
    bench.finish(bench.go(rig, *near(rig, 1, 0, 0, 0, 0)))
    with pytest.raises(MotionError, match="away from where this plan starts; plan again"):
        bench.finish(rig.arm.move(plan, wait=False))
    stays(bench, rig)


def test_waypoints_are_passed_and_the_path_is_kept(bench, rig):
    middle = near(rig, 0.5, 0.5, 0.5, 0.5, 0.5)
    plan, way = random_plan(rig, 5, waypoints=3, middle=middle, reach=0.5 * STEP_DEG)
    followed = follow(bench, rig, plan, way)
    assert followed.error < 3.0
    assert followed.missed < 3.0
    assert followed.final <= 0.3
    assert followed.lag < 0.15


def test_no_move_is_faster_or_accelerates_harder_than_its_arm_may(bench, rig):
    speed, acceleration = np.radians((10.0, 50.0))
    rig.arm.set_speed(speed)
    rig.arm.set_acceleration(acceleration)
    tape = []
    end = rig.executor.listen(lambda state: tape.append((state.t, *state.q_ref)))
    bench.finish(bench.go(rig, *near(rig, 1, 0, 0, -0.5, 1)))
    end()
    t, q = np.array(tape)[:, 0], np.array(tape)[:, 1:]
    qd = np.diff(q, axis=0) / rig.executor.dt
    qdd = np.diff(qd, axis=0) / rig.executor.dt
    assert 0.9 * speed < np.abs(qd).max() <= speed * 1.001
    assert np.abs(qdd[np.diff(t)[1:] < 1.5 * rig.executor.dt]).max() <= acceleration * 1.02


def test_a_newer_move_ends_the_older_one_and_arrives(bench, rig):
    start = np.degrees(rig.arm.state.q)
    rig.arm.set_speed(SLOW)
    first = send(rig, near(rig, 1, 0, 0, 0, 0))
    bench.under_way(first, rig, 0.5)
    rig.arm.set_speed(3 * SLOW)
    second = send(rig, start)
    bench.finish(second)
    with pytest.raises(Interrupted, match="a newer motion"):
        bench.finish(first)
    assert stays(bench, rig) == pytest.approx(start, abs=0.35)


INSTANTS = {
    "while it is planned": (None, 0.0, 0.05),
    "as it begins": (0.0, 0.0, 0.3),
    "on its way": (0.7, 0.2, 0.8),
    "while it slows down": (1.6, 0.7, 1.05),
}
"""How long it has been under way [s], and which share of its way it then has behind it."""


@pytest.mark.parametrize(("seconds", "least", "most"), INSTANTS.values(), ids=INSTANTS)
def test_a_stop_at_any_instant_brings_the_arm_to_rest_on_its_path(bench, rig, seconds, least, most):
    start, goal = np.degrees(rig.arm.state.q), near(rig, 1, 0, 0, 0, 0)
    rig.arm.set_speed(SLOW)
    motion = send(rig, goal)
    if seconds is not None:
        bench.under_way(motion, rig, seconds)
    bench.finish(rig.arm.start_stop())
    with pytest.raises(Interrupted, match="stop"):
        bench.finish(motion)
    share = (stays(bench, rig) - start)[0] / (goal - start)[0]
    assert least - 0.08 < share < most + 0.08


def test_a_new_target_is_turned_to_without_a_stop(bench, rig):
    start = np.degrees(rig.arm.state.q)
    first = rig.arm.retarget(np.radians(near(rig, 1, 0, 0, 0, 0)))
    bench.under_way(first, rig, 0.2)
    farther = start + 1.2 * (near(rig, 1, 0, 0, 0, 0) - np.degrees(rig.arm.state.q))
    second = rig.arm.retarget(np.radians(farther))
    bench.advance(0.03)
    assert rig.arm.state.arm_moving
    with pytest.raises(Interrupted, match="a newer motion"):
        bench.finish(first)
    bench.finish(second)
    assert stays(bench, rig) == pytest.approx(farther, abs=0.35)


def test_a_goal_outside_the_range_is_refused_by_name_and_nothing_moves(bench, rig):
    before = place(bench, rig)
    outside = np.radians([0.0, 0.0, 120.0, 0.0, 0.0])
    for ask in (
        lambda: rig.arm.retarget(outside),
        lambda: bench.finish(send(rig, [0, 0, 120, 0, 0])),
    ):
        with pytest.raises(OutsideLimits, match="elbow_flex = 120"):
            ask()
    assert stays(bench, rig) == pytest.approx(before, abs=0.5)


def test_an_arm_that_was_put_elsewhere_by_hand_is_moved_from_there(bench, rig):
    goal = near(rig, 1, 0, 0, 0, 0)
    rig.arm.set_manual(True)
    assert rig.arm.is_movable_by_hand
    bench.finish(send(rig, goal))
    assert not rig.arm.is_movable_by_hand
    assert stays(bench, rig) == pytest.approx(goal, abs=0.35)
