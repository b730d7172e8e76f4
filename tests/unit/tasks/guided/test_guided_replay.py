"""Replaying a guided path on the simulated arm."""

import numpy as np
import pytest

from so101_motion.common.errors import InCollision, Interrupted, OutsideLimits
from so101_motion.common.geometry import SE3
from so101_motion.common.modes import Mode
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.tasks.guided import GuidedPath, plan_replay, start_replay

HERE = [0, -40, 40, 20, 0]
LOOP = ([30, -40, 40, 20, 0], [30, -60, 60, 20, 40], [0, -40, 40, 20, 0], [-20, -50, 30, 40, -30])


def between(corners, where):
    return np.column_stack([np.interp(where, range(len(corners)), each) for each in corners.T])


def path_through(*corners_deg, seconds=1.0, aperture=None):
    """A hand that leads the arm along corners; the jaw, if any, likewise."""
    rng = np.random.default_rng(1)
    where = np.linspace(0.0, len(corners_deg) - 1.0, round(50 * seconds * (len(corners_deg) - 1)))
    corners = np.radians(np.array(corners_deg, dtype=float))
    q = between(corners, where)
    q += np.radians(0.1) * rng.standard_normal(q.shape)
    if aperture is not None:
        aperture = np.interp(where, np.arange(len(corners)), aperture)
    return GuidedPath(t=0.02 * np.arange(len(q)), q=q, aperture=aperture)


def off_path(path, q_deg):
    """How far points [deg] are from a path at most, and the path from them."""
    recorded = np.degrees(between(path.q, np.linspace(0.0, len(path) - 1.0, 5 * len(path))))
    off = np.abs(q_deg[:, None] - recorded).max(axis=2)
    return max(off.min(axis=0).max(), off.min(axis=1).max())


@pytest.mark.parametrize("tolerance_deg", [0.5, 2.0, 6.0])
def test_a_taught_path_is_replayed_within_the_tolerance_and_the_caps(guest, tolerance_deg):
    path = path_through(HERE, *LOOP, seconds=0.5)
    replay = plan_replay(guest.rig.arm, path, tolerance=np.radians(tolerance_deg))
    assert len(replay.legs) == 1
    begin = guest.clock.now()
    guest.finish(start_replay(guest.rig.arm, None, replay))
    t, q, _ = guest.sent(begin)
    first = int(np.argmax(np.abs(q - np.degrees(path.q[0])).max(axis=1) < 1e-6))
    assert off_path(path, q[first::2]) <= tolerance_deg + 0.2, "0.2 deg by the spacing of points"
    speed = np.abs(np.diff(q, axis=0)) / np.diff(t)[:, None]
    limits = guest.rig.arm.limits
    assert speed.max() <= np.degrees(limits.velocity[0]) * 1.001
    assert np.abs(np.diff(speed, axis=0)).max() / 0.01 <= np.degrees(limits.acceleration[0]) * 1.01
    assert q[-1] == pytest.approx(np.degrees(path.q[-1]), abs=1e-6)


def test_it_does_not_stop_on_the_way_and_a_wider_tolerance_is_swifter(guest):
    path = path_through(HERE, *LOOP)
    tight, wide = (
        plan_replay(guest.rig.arm, path, tolerance=np.radians(degrees)) for degrees in (1.0, 8.0)
    )
    assert wide.duration < tight.duration
    speed = np.abs(wide.legs[0].plan.trajectory.qd).max(axis=1)
    assert speed[40:-40].min() > 0.1


def test_it_goes_as_fast_as_it_is_told_to(guest):
    path = path_through(HERE, *LOOP)
    slow = MotionLimits.uniform(velocity=0.2, acceleration=1.0, jerk=20.0)
    replay = plan_replay(guest.rig.arm, path, limits=slow)
    assert max(np.abs(plan.trajectory.qd).max() for plan in replay.plans) <= 0.2 * 1.001


def test_the_jaw_is_where_it_was_at_each_place_however_fast_the_arm_goes(guest):
    path = path_through(HERE, *LOOP[:2], aperture=[0.0, 1.0, 0.0])
    path = GuidedPath(t=path.t, q=path.q, aperture=path.aperture)
    rig = guest.rig
    replay = plan_replay(rig.arm, path, gripper=rig.gripper)
    (leg,) = replay.legs
    begin = guest.clock.now()
    guest.finish(start_replay(rig.arm, rig.gripper, replay))
    _, q, q_jaw = guest.sent(begin)
    aperture = (q_jaw - rig.gripper.closed) / (rig.gripper.opened - rig.gripper.closed)
    first = len(replay.approach.trajectory)
    for here, opened in zip(q[first:], aperture[first:], strict=True):
        k = int(np.argmin(np.abs(leg.plan.trajectory.q - np.radians(here)).max(axis=1)))
        assert opened == pytest.approx(leg.aperture[k], abs=0.06)
    assert leg.aperture.max() > 0.9
    speed = np.abs(np.diff(q_jaw)) / 0.01
    assert speed.max() <= rig.gripper.limits.velocity[0] * 1.001


def test_an_arm_waits_for_a_jaw_that_is_slower(guest):
    path = path_through(HERE, [4, -40, 40, 20, 0], aperture=[0.0, 1.0])
    rig = guest.rig
    alone = plan_replay(rig.arm, path).legs[0].plan.duration
    together = plan_replay(rig.arm, path, gripper=rig.gripper)
    assert together.legs[0].plan.duration > 1.5 * alone
    assert together.legs[0].aperture[-1] == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("at", [0, 1, 2])
def test_an_arm_that_is_nudged_while_the_jaw_closes_goes_the_rest_of_the_way_as_fast(guest, at):
    corners = [*LOOP[:3]]
    corners.insert(at, [corners[at][0] + 0.7, *corners[at][1:]])
    aperture = [1.0] * (at + 1) + [0.0] * (3 - at)
    path = path_through(*corners, aperture=aperture, seconds=2.0)
    rig = guest.rig
    alone = plan_replay(rig.arm, path).duration
    together = plan_replay(rig.arm, path, gripper=rig.gripper)
    assert together.duration < alone + 4.0
    begin = guest.clock.now()
    guest.finish(start_replay(rig.arm, rig.gripper, together))
    _, q, q_jaw = guest.sent(begin)
    first = len(together.approach.trajectory)
    closing = q[first:][np.gradient(q_jaw[first:]) < -1e-3]
    assert np.ptp(closing, axis=0).max() < 1.5
    assert rig.gripper.aperture == pytest.approx(0.0, abs=0.02)


def test_a_jaw_that_turns_to_opening_lets_go_there(guest):
    path = path_through(HERE, *LOOP[:3], aperture=[0.8, 0.2, 0.2, 0.9])
    replay = plan_replay(guest.rig.arm, path, gripper=guest.rig.gripper)
    assert len(replay.legs) == 2
    assert np.degrees(replay.legs[1].plan.q_start) == pytest.approx(LOOP[1], abs=2.0)


# What ends it


@pytest.mark.parametrize("seconds", [0.3, 1.5, 3.0])
def test_a_stop_ends_it_anywhere_and_the_jaw_stops_too(guest, seconds):
    path = path_through(HERE, *LOOP, aperture=[1.0, 0.1, 0.1, 1.0, 0.0])
    rig = guest.rig
    motion = start_replay(rig.arm, rig.gripper, plan_replay(rig.arm, path, gripper=rig.gripper))
    while not (rig.arm.state.arm_moving or rig.gripper.is_moving):
        guest.clock.advance(0.01)
    guest.clock.advance(seconds)
    motion.interrupt("stop")
    with pytest.raises(Interrupted):
        guest.finish(motion, at_most=2.0)
    guest.clock.advance(1.0)
    assert rig.arm.state.mode is Mode.HOLDING
    begin = guest.clock.now()
    guest.clock.advance(1.0)
    _, q, q_jaw = guest.sent(begin)
    assert np.ptp(q, axis=0).max() == 0.0
    assert np.ptp(q_jaw) == 0.0


def test_an_obstacle_on_the_path_is_refused_also_if_it_comes_after_the_planning(guest):
    planned = plan_replay(guest.rig.arm, path_through(HERE, *LOOP))
    box = Obstacle(
        name="box", shape=Box(size=(0.1, 0.1, 0.5)), T_base_obstacle=SE3.from_translation(
            guest.rig.arm.model.frame(np.radians(LOOP[0])).p
        ),
    )  # fmt: skip
    guest.rig.arm.scene = Scene(obstacles=(box,))
    with pytest.raises(InCollision, match="into the recording"):
        plan_replay(guest.rig.arm, path_through(HERE, *LOOP))
    with pytest.raises(InCollision, match="'box'; plan again"):
        guest.finish(start_replay(guest.rig.arm, None, planned))


def test_a_jaw_that_would_touch_where_it_opens_is_refused(guest):
    rig = guest.rig
    q = np.radians(HERE)
    opened = rig.arm.model.link_placements(q, rig.gripper.opened)
    closed = rig.arm.model.link_placements(q, rig.gripper.closed)
    assert opened.keys() == closed.keys()
    tip = rig.arm.model.frame(q, "jaw_tip")
    aside = tip @ np.array([-0.09, 0.0, -0.02])
    small = Obstacle(
        name="peg", shape=Box(size=(0.01, 0.01, 0.01)), T_base_obstacle=SE3.from_translation(aside)
    )
    rig.arm.scene = Scene(obstacles=(small,), floor_z=None)
    path = path_through(HERE, [2, -40, 40, 20, 0], aperture=[0.0, 1.0])
    plan_replay(rig.arm, path)  # the arm alone may go there
    with pytest.raises(InCollision, match=r"jaw as it was there.*peg|peg.*jaw"):
        plan_replay(rig.arm, path, gripper=rig.gripper)


def test_a_hand_that_pushed_against_a_stop_is_understood_and_another_arm_s_path_is_not(guest):
    lower, _ = (np.degrees(bound) for bound in guest.rig.arm.range)
    beyond = [0, -40, 40, 20, lower[4] - 1.0]
    replay = plan_replay(guest.rig.arm, path_through(HERE, beyond))
    assert np.degrees(replay.plans[-1].q_goal[4]) == pytest.approx(lower[4], abs=0.01)
    with pytest.raises(OutsideLimits, match="wrist_roll is at"):
        plan_replay(guest.rig.arm, path_through(HERE, [0, -40, 40, 20, lower[4] - 10.0]))
