"""Following targets, through the executor on a clock the test drives."""

import logging
import math

import numpy as np
import pytest
from harness.setpoints import shares

from so101_motion.common.attributes import LoadConfig
from so101_motion.common.errors import (
    ConfigError,
    FollowingError,
    Interrupted,
    MotionError,
    Overloaded,
)
from so101_motion.common.geometry import SE3
from so101_motion.common.modes import Mode
from so101_motion.control.cartesian_jog import Jog
from so101_motion.control.following import KNOWN_JERK, STALE_AFTER, Following
from so101_motion.control.following_check import FollowingCheck
from so101_motion.control.joint_group import Channel, Tolerances
from so101_motion.control.motion_source import PlannedMotion
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.differential.servo import Servo
from so101_motion.planning.goals import PoseGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.pursuit import FORESIGHT, Pursuit
from so101_motion.planning.timing.trajectory import Setpoint
from so101_motion.rig.simulated_rig import open_simulated

CAPS = MotionLimits.uniform(velocity=2.0, acceleration=6.0, jerk=150.0)
SLOW = MotionLimits.uniform(velocity=0.3, acceleration=1.0, jerk=30.0)
LOWER, UPPER = np.full(5, -1.0), np.full(5, 1.0)


def leading(clock, motion):
    """Aims where ``motion`` says at each instant; None is nowhere."""

    def each(following):
        t = clock.now() + 0.01
        q = motion(t)
        if q is None:
            following.hold()
        else:
            following.aim(q, (motion(t + 1e-4) - motion(t - 1e-4)) / 2e-4)

    return each


class Fence:
    """A guard that lets nothing beyond an angle of the first joint."""

    look_every = 0.02

    def __init__(self, at):
        self.at, self.against = at, ()

    def within_reach(self, q, q_target, others):
        return q_target

    def admits(self, way, *, ahead=False):
        return bool(np.all(way[:, 0] <= self.at))


def made(**settings):
    return Following(
        **{"q_start": np.zeros(5), "lower": LOWER, "upper": UPPER, "limits": CAPS, "dt": 0.01}
        | settings
    )


def made_for(sim, **settings):
    stop = sim.executor.stop_limits(Channel.ARM)
    return made(**{"q_start": sim.state.q_ref, "stop_limits": stop} | settings)


def follow(sim, **settings):
    return sim.executor.play(made_for(sim, **settings))


def chase(sim, motion, guard=None):
    return follow(sim, each=leading(sim.clock, motion), guard=guard)


def assert_bounded(sim):
    highest = MotionLimits.uniform(velocity=2.0, acceleration=8.0, jerk=200.0)
    assert max(shares(sim.arm.goals, sim.dt, highest)) <= 1.01


def test_a_target_that_sways_is_followed_without_much_delay(sim):
    following = chase(sim, lambda t: np.full(5, 0.5 * np.sin(2.5 * t)))
    sim.clock.advance(4.0)
    assert following.expected_acceleration.qdd is None, "the driver cannot know what is not said"
    wanted = 0.5 * np.sin(2.5 * (sim.arm.times[200:] + 0.01))
    assert np.abs(sim.arm.goals[200:, 0] - wanted).max() < 0.002
    assert_bounded(sim)


def test_joints_without_a_target_come_to_rest_and_wait(sim):
    following = chase(sim, lambda t: np.full(5, t) if t < 0.5 else None)
    sim.clock.advance(1.5)
    assert sim.state.mode is Mode.MOVING
    assert not following.future.done()
    assert np.all(sim.state.qd_ref == 0.0)
    where = sim.state.q_ref
    sim.clock.advance(1.0)
    assert np.array_equal(sim.state.q_ref, where)
    assert_bounded(sim)


def test_an_obstacle_holds_the_joints_until_the_target_comes_back(sim):
    back = []
    following = chase(sim, lambda t: np.full(5, 0.9 if not back else 0.1), Fence(0.5))
    sim.clock.advance(2.0)
    assert following.is_held
    assert 0.3 < sim.state.q_ref[0] <= 0.5
    assert np.all(sim.state.qd_ref == 0.0)
    back.append(True)
    sim.clock.advance(2.0)
    assert not following.is_held
    assert sim.state.q_ref == pytest.approx(np.full(5, 0.1), abs=1e-6)
    assert np.all(sim.arm.goals[:, 0] <= 0.5)
    assert_bounded(sim)


class Narrow(Fence):
    """A guard that has room for short paths only: how far they may lead a joint [rad]."""

    def admits(self, way, *, ahead=False):
        return bool(np.ptp(way, axis=0).max() <= self.at)


def test_an_arm_with_little_room_to_brake_sets_out_gently_and_is_not_held_for_good():
    caps = MotionLimits.uniform(velocity=3.0, acceleration=6.0, jerk=500.0)
    stop = MotionLimits.uniform(velocity=3.0, acceleration=6.0, jerk=60.0)
    narrow = Narrow(0.01)
    following = made(limits=caps, stop_limits=stop, guard=narrow, stale_after=None)
    following.aim([0.5, 0.0, 0.0, 0.0, 0.0])
    at_once = Pursuit(5, 0.01).towards(following.now, [0.5, 0, 0, 0, 0], np.zeros(5), caps)
    stopping = online.stop(at_once.q, at_once.qd, at_once.qdd, stop, 0.01).q
    assert np.ptp(stopping, axis=0).max() > narrow.at, "at full jerk there is no room"
    for k in range(100):
        following.sample(k)
    assert following.now.q[0] > 5.0 * narrow.at


def test_joints_that_begin_outside_may_come_in_but_not_go_further_out(make_sim, taped_arm, clock):
    sim = make_sim(taped_arm(clock, q=np.full(5, 1.05)))
    sim.executor.start()
    chase(sim, lambda t: np.full(5, 2.0 if t < 0.5 else 0.0))
    sim.clock.advance(0.5)
    assert np.all(sim.arm.goals <= 1.05 + 1e-6)
    sim.clock.advance(2.0)
    assert sim.state.q_ref == pytest.approx(np.zeros(5), abs=1e-6)


def test_a_joint_that_is_held_fast_ends_it(sim):
    following = chase(sim, lambda t: np.full(5, min(t, 0.8)))
    sim.clock.advance(0.2)
    sim.arm.jam("elbow_flex")
    error = sim.error_after(2.0, following.future)
    assert isinstance(error, FollowingError)
    assert error.joint == "elbow_flex"


def test_a_target_is_taken_up_in_the_next_period_and_held_until_it_is_stale(sim):
    following = follow(sim)
    sim.clock.advance(0.1)
    following.aim(np.full(5, 0.8))
    before = len(sim.arm.tape)
    sim.clock.advance(0.01)
    assert len(sim.arm.tape) == before + 1
    assert np.all(sim.arm.goals[-1] > 0.0)
    sim.clock.advance(STALE_AFTER)
    assert np.all(sim.state.qd_ref > 0.0)
    sim.clock.advance(1.0)
    assert np.all(sim.state.qd_ref == 0.0)
    assert sim.state.q_ref[0] < 0.7, "it braked for nobody repeated it"
    assert not following.future.done()
    following.aim(np.full(5, 0.8))
    sim.clock.advance(0.05)
    assert np.all(sim.state.qd_ref > 0.0)
    assert_bounded(sim)


def test_a_target_that_moves_is_taken_to_move_on(sim):
    following = follow(sim, stale_after=None)
    following.aim(np.zeros(5), np.full(5, 0.3))
    sim.clock.advance(2.0)
    wanted = 0.3 * 2.0
    assert sim.state.q_ref == pytest.approx(np.full(5, wanted), abs=1e-6)
    sim.clock.advance(4.0)
    assert sim.state.q_ref == pytest.approx(UPPER, abs=1e-6), "and no further than the range"


def test_the_driver_is_told_how_a_target_accelerates_that_says_so(sim):
    def sways(following):
        t, w = sim.clock.now() + 0.01, 2.5
        s, c = np.full((2, 5), 0.3) * [[np.sin(w * t)], [np.cos(w * t)]]
        following.aim(s, w * c, -w * w * s)

    following = follow(sim, each=sways)
    sim.clock.advance(3.0)
    wanted = 0.3 * np.sin(2.5 * (sim.arm.times[-1] + 0.01))
    assert sim.arm.goals[-1] == pytest.approx(np.full(5, wanted), abs=2e-3)
    assert following.expected_acceleration.qdd == pytest.approx(np.full(5, -6.25 * wanted), abs=0.1)
    assert_bounded(sim)


def test_the_driver_is_told_of_no_speed_that_the_command_will_not_have(sim):
    told, rng = [], np.random.default_rng(3)

    def raves(following):
        told.append((following.expected_acceleration.qdd, following.now.qdd, following.now.qd))
        following.aim(rng.uniform(-1.0, 1.0, 5), rng.normal(size=5), 1e6 * rng.normal(size=5))

    follow(sim, each=raves)
    sim.clock.advance(3.0)
    known, true, qd = np.array(told[2:]).transpose(1, 0, 2)
    faster, accelerates = np.sign(qd) * known, np.sign(qd) * true
    assert np.all(faster <= np.maximum(accelerates, 0.0) + 1e-9), "as fast as that, not faster"
    to_rest = -np.abs(qd) / FORESIGHT
    assert np.all(faster >= np.minimum(accelerates, to_rest) - 1e-9), "nor the other way"
    rises = np.diff(np.abs(known), axis=0)
    assert rises.max() <= KNOWN_JERK * sim.dt + 1e-9, "and no faster than servos bear it"
    assert_bounded(sim)


def test_the_driver_is_told_how_joints_brake_whose_target_said_how_it_accelerates(sim):
    told, t_end = [], sim.clock.now() + 0.4

    def sways(following):
        t = sim.clock.now()
        told.append((following.expected_acceleration.qdd, following.now.qdd))
        if t > t_end:
            return following.hold()
        following.aim(np.full(5, 2.0 * t * t), np.full(5, 4.0 * t), np.full(5, 4.0))

    follow(sim, each=sways)
    sim.clock.advance(0.7)
    braked = [(known, true) for known, true in told if np.any(true < 0.0)]
    assert len(braked) > 10
    for known, true in braked:
        assert known == pytest.approx(true)


def test_invalid_targets_are_refused_and_the_former_one_stays(sim):
    following = follow(sim, stale_after=None)
    following.aim(np.full(5, 0.2))
    for q, qd in (
        ([math.nan, 0, 0, 0, 0], None),
        (np.full(5, math.inf), None),
        (np.zeros(4), None),
        ("up", None),
        (np.zeros(5), [0, 0, math.nan, 0, 0]),
    ):
        with pytest.raises(ConfigError):
            following.aim(q, qd)
    with pytest.raises(ConfigError):
        following.aim(np.zeros(5), np.zeros(5), [0, 0, math.inf, 0, 0])
    sim.clock.advance(1.0)
    assert sim.state.q_ref == pytest.approx(np.full(5, 0.2), abs=1e-6)


def test_a_target_beyond_the_range_is_clipped_and_says_so(sim):
    following = follow(sim, stale_after=None)
    taken = following.aim([0.5, 1.5, -1.25, 0.0, 1.0])
    assert taken == pytest.approx([0.5, 1.0, -1.0, 0.0, 1.0])
    assert following.outside == pytest.approx([0.0, 0.5, -0.25, 0.0, 0.0])
    sim.clock.advance(2.0)
    assert sim.state.q_ref == pytest.approx(taken, abs=1e-6)
    assert following.held_by == (
        "shoulder_lift at its upper limit",
        "elbow_flex at its lower limit",
    )
    following.aim(np.zeros(5))
    assert following.held_by == ()


def test_one_that_has_ended_says_why_at_the_next_aim(sim):
    following = follow(sim)
    sim.clock.advance(0.1)
    sim.after(0.5, sim.executor.stop(by="somebody"))
    with pytest.raises(Interrupted, match="somebody"):
        following.aim(np.zeros(5))
    closed = follow(sim)
    sim.after(0.5, closed.close())
    with pytest.raises(MotionError, match="over"):
        closed.aim(np.zeros(5))


def test_the_first_target_is_approached_slowly_and_so_is_one_after_a_rest(sim):
    following = follow(sim, approach=SLOW, stale_after=None)
    for goal in (0.6, 0.0):
        following.aim(np.full(5, goal))
        sim.clock.advance(0.5)
        assert following.is_approaching
        assert np.abs(sim.state.qd_ref).max() == pytest.approx(SLOW.velocity[0])
        sim.clock.advance(3.0)
        assert not following.is_approaching
        assert sim.state.q_ref == pytest.approx(np.full(5, goal), abs=1e-6)
        following.aim(np.full(5, goal + 0.3))
        sim.clock.advance(0.2)
        assert np.abs(sim.state.qd_ref).max() > 2.0 * SLOW.velocity[0], "a jump in between is not"
        following.hold()
        sim.clock.advance(1.0)


def test_when_the_source_of_targets_fails_the_joints_come_to_rest(sim):
    def each(following):
        if sim.clock.now() > 0.3:
            raise ValueError("oh")
        following.aim(np.full(5, 0.9))

    following = follow(sim, each=each)
    error = sim.error_after(2.0, following.future)
    assert isinstance(error, MotionError)
    assert "oh" in str(error)
    assert sim.state.mode is Mode.HOLDING
    assert_bounded(sim)


def test_a_guarded_one_lets_a_planned_motion_come_to_rest_on_its_own_path_first(sim):
    plan = sim.to_goal(np.array([1.0, 0.5, 0.0, 0.0, 0.0]))
    sim.executor.execute(plan)
    sim.clock.advance(0.5)
    following = made_for(sim, guard=Fence(2.0), stale_after=None)
    following.aim([0.0, 0.0, 0.5, 0.0, 0.0])
    sim.executor.turn(following)
    begin = len(sim.arm.tape)
    while np.any(sim.state.qd_ref) or len(sim.arm.tape) < begin + 2:
        sim.clock.advance(0.01)
    braked = sim.arm.goals[begin:]
    assert braked[:, 1] == pytest.approx(0.5 * braked[:, 0], abs=1e-9), "along the plan"
    assert np.all(braked[:, 2] == 0.0)
    sim.clock.advance(3.0)
    assert sim.state.q_ref == pytest.approx([0.0, 0.0, 0.5, 0.0, 0.0], abs=1e-6)


def test_the_guard_hears_when_the_servos_may_be_ahead_of_the_setpoint(sim):
    class Heard(Fence):
        ahead = ()

        def admits(self, way, *, ahead=False):
            self.ahead = (*self.ahead, ahead)
            return True

    guard, t_end = Heard(9.0), sim.clock.now() + 0.3

    def says_less(following):
        rest = np.zeros(5)
        following.aim(rest, rest, rest if sim.clock.now() < t_end else None)

    follow(sim, each=says_less, guard=guard)
    sim.clock.advance(1.2)
    assert all(guard.ahead[:29])
    assert all(guard.ahead[32:78]), "what makes up for lag is given up slowly"
    assert not any(guard.ahead[82:])


FAR = {"lower": np.full(5, -3.0), "upper": np.full(5, 3.0), "stale_after": None}


def guarded():
    stop = MotionLimits.uniform(velocity=math.pi, acceleration=6.6, jerk=60.0)
    return made(**FAR, stop_limits=stop, guard=Fence(at=2.0))


def on_its_way(sim, k):
    """A planned motion that accelerates as hard as any may, and its setpoint ``k``."""
    hard = MotionLimits.uniform(velocity=math.pi, acceleration=math.radians(430.0), jerk=75.0)
    goal = np.array([1.5, 1.0, 0.5, -0.8, 2.0])
    planned = PlannedMotion(online.point_to_point(np.zeros(5), goal, hard, sim.dt))
    for i in range(k):
        now = planned.sample(i)
    return planned, now, goal


@pytest.mark.parametrize("k", range(5, 90, 20))
def test_a_planned_motion_is_left_on_its_path_however_hard_it_moved(sim, k):
    planned, now, goal = on_its_way(sim, k)
    following = guarded()
    following.aim(np.full(5, -0.5))
    following.take_over(now, planned, sim.executor.stop_limits(Channel.ARM))
    while following.keeps_apart is following.is_guarded is False and now.qd.any():
        now = following.sample(0)
        across = now.q - goal * (now.q @ goal) / (goal @ goal)
        assert np.max(np.abs(across)) < 1e-3


def test_a_following_that_was_still_slowing_another_motion_goes_on_from_rest_after_a_pause(sim):
    planned, now, _ = on_its_way(sim, 45)
    following, brakes = guarded(), sim.executor.stop_limits(Channel.ARM)
    following.aim(np.full(5, -0.5))
    following.take_over(now, planned, brakes)
    now = following.sample(0)
    assert np.max(np.abs(now.qd)) > 0.5
    following.take_over(Setpoint.at_rest(now.q), None, brakes)
    assert np.max(np.abs(following.sample(0).qd)) < 0.1


@pytest.mark.parametrize("jerk", [150.0, 1000.0])
def test_joints_that_are_told_to_brake_while_they_speed_up_keep_their_speed_cap(jerk):
    """A stop takes an acceleration back more slowly than it was built up."""
    rng = np.random.default_rng(1)
    caps = MotionLimits.uniform(velocity=1.0, acceleration=6.0, jerk=jerk)
    stop = MotionLimits.uniform(velocity=3.0, acceleration=6.0, jerk=60.0)
    following = made(**FAR, limits=caps, stop_limits=stop)
    q = [following.now.q]
    for k in range(2000):
        if k % 40 == 0:
            following.aim(rng.uniform(-2.0, 2.0, 5))
        if rng.random() < 0.04:
            following.hold()
        elif following.target is None:
            following.aim(rng.uniform(-2.0, 2.0, 5))
        q.append(following.sample(k).q)
    speeds = np.abs(np.diff(q, axis=0)) / 0.01
    assert 0.95 < speeds.max() <= 1.0 + 1e-6


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_joints_stop_before_the_end_of_their_range_though_their_target_runs_on(way):
    following = made(stop_limits=CAPS)
    for k in range(200):
        following.aim(np.full(5, 0.95 * way), np.full(5, 1.8 * way))
        assert np.max(way * following.sample(k).q) <= 1.0 + 1e-6


# Whether joints follow


DT = 0.01
TOLERANCES = Tolerances(
    following_lag=0.15, contact_distance=np.radians(1.6), pressed_stray=np.radians(0.5)
)


def way(speed, ticks):
    """Setpoints of a steady speed [deg]."""
    return speed * DT * np.arange(float(ticks))


def met(setpoints, tick):
    """A joint that follows until it meets something at a tick."""
    return np.where(np.arange(len(setpoints)) < tick, setpoints, setpoints[tick])


IN_PLAY = 0.8  # how far an emulated joint falls behind in its play at 10 deg/s, and a margin [deg]


def seen(setpoints, joints, tolerances=TOLERANCES, pressed_from=1000, in_play=IN_PLAY):
    """At which tick a joint that goes through ``joints`` [deg] is held up; None if never."""
    check = FollowingCheck(tolerances, DT)
    check.begin(np.radians(setpoints[:1]))
    for k, (setpoint, joint) in enumerate(zip(setpoints, joints, strict=True)):
        check.want(np.radians([setpoint]))
        if check.held_up(np.radians([joint]), [np.radians(in_play * (k < pressed_from))]):
            return k
    return None


@pytest.mark.parametrize(
    ("speed", "ticks", "pressed_from"),
    [
        *((speed, 9, 1000) for speed in (25.0, -25.0, 90.0, 180.0)),  # within 90 ms
        # one that followed slowly, once it stands longer than its play lets it
        *((10.0, 9, 1000), (-10.0, 9, 1000), (15.0, 6, 1000), (20.0, 5, 1000)),
        # sooner, if its load stays on one side
        *((8.0, 8, 0), (-10.0, 6, 0), (15.0, 5, 0), (20.0, 5, 0)),
    ],
)
def test_a_joint_that_meets_something_is_held_up_soon(speed, ticks, pressed_from):
    setpoints = way(speed, 150)
    found = seen(setpoints, met(setpoints, 80), pressed_from=pressed_from)
    assert 80 < found <= 80 + ticks


def test_one_that_trembles_at_what_it_met_is_held_up():
    setpoints = way(10.0, 120)
    joint = met(setpoints, 80)
    joint[80:90] += [0.0, -0.09, 0.0, 0.09, -0.09, 0.0, 0.09, 0.0, 0.18, 0.18]
    joint[90:] += 0.26
    assert 80 < seen(setpoints, joint) <= 80 + 11


TURN = np.abs(np.linspace(-30.0, 30.0, 120))
STOPPING = -np.array([67.4, 68.0, 68.7, 69.2, 69.8, 70.3, 70.8, 71.2, 71.6, 71.9, 72.3, 72.6,
                      72.8, 73.0, 73.2, 73.4, 73.5, 73.6, 73.7, 73.8, 73.8])  # fmt: skip
ARRIVING = np.concatenate([np.linspace(-15.0, STOPPING[0], 50), STOPPING])
SOFT = {"tolerances": Tolerances(following_lag=0.15)}
TURNING = np.maximum(met(way(7.0, 100), 70), way(7.0, 100) - 0.1)
TURNING[70:81] = way(7.0, 100)[70]
TURNING[78:81] -= [0.27, 0.0, -0.17]
SLOW_WAY, FALLS = way(5.0, 200), way(5.0, 200)
FALLS[100:103] = SLOW_WAY[100] + 0.9
FALLS[103:] = np.maximum(SLOW_WAY[100] + 0.6, SLOW_WAY[103:] - 0.75)
FAST_WAY = 60.0 * np.cos(2.5 * DT * np.arange(400.0))  # up to 150 deg/s


def crossing(speed, play):
    """Setpoints, and a joint that stands for its play from the hundredth on."""
    setpoints = way(speed, 200)
    return setpoints, np.maximum(met(setpoints, 100), setpoints - play)


@pytest.mark.parametrize(
    ("setpoints", "joint", "options"),
    [
        (way(10.0, 200), 0.4 * np.floor(way(10.0, 200) / 0.4), {"pressed_from": 0}),
        (TURN, np.where(np.arange(120) < 60, TURN, np.maximum(TURN - 1.3, 0.0)), {}),
        (way(50.0, 60), np.minimum(way(50.0, 60) + 4.0, np.maximum(way(50.0, 60), 20.0)), {}),
        (ARRIVING, np.maximum(ARRIVING - 1.0, -72.9), {}),
        (way(15.0, 60), way(15.0, 60) - np.linspace(0.0, 1.0, 60) * 1.2, {}),
        (way(90.0, 100), np.minimum(way(90.0, 100), 40.0), SOFT),
        (way(7.0, 100), TURNING, {}),
        (*crossing(10.0, 0.75), {"pressed_from": 95}),
        (SLOW_WAY, FALLS, {"pressed_from": 0}),
        *(
            (*crossing(speed, 0.99 * play), {"in_play": play})
            for speed in (5.0, 10.0, 20.0, 30.0)
            for play in (0.6, 1.0)
        ),
        *((FAST_WAY, np.append(np.full(n, FAST_WAY[0]), FAST_WAY[:-n]), {}) for n in (5, 14)),
    ],
    ids=[
        "sticks and slips by little",
        "loses its play at a turn",
        "ran ahead and waits for its setpoints",
        "ran ahead and stands where they come to rest, an emulated shoulder from 120 deg/s",
        "falls back",
        "shall be stopped by what it meets, and presses",
        "falls back on its motor as its load turns round, an emulated one with 1.02 deg of play",
        "stands for its play, as its load came to that side just now",
        "fell through its play and waits for its motor, as an emulated shoulder_lift did",
        *(f"stands for its play as its load changes sides, {k}" for k in range(8)),
        "lags by 50 ms",
        "lags by 140 ms",
    ],
)
def test_a_joint_that_has_met_nothing_is_not_held_up(setpoints, joint, options):
    assert seen(setpoints, joint, **options) is None


def told_in_silence(missed, ticks, speed=15.0, tolerances=TOLERANCES):
    """What is said of a joint whose servo is silent for ``ticks`` and may miss its goals."""
    check, way = FollowingCheck(tolerances, DT), np.radians(speed * DT * np.arange(150.0))
    check.begin(way[:1])
    for k, setpoint in enumerate(way):
        silent = 80 <= k < 80 + ticks
        behind = min(max(k - 80, 0), ticks) * (way[1] - way[0]) if missed else 0.0
        check.want(np.array([setpoint]))
        q = setpoint if silent else setpoint - behind
        if check.held_up(np.array([q]), [np.radians(IN_PLAY)], silent=silent):
            return check.words(0, held_up=True)
    return None


@pytest.mark.parametrize(
    ("missed", "ticks", "speed"),
    [(False, 20, 15.0), (True, 4, 15.0), (True, 4, 45.0), (True, 4, -90.0)],
)
def test_joints_that_get_their_goals_in_a_silence_or_miss_a_few_go_on(missed, ticks, speed):
    assert told_in_silence(missed, ticks, speed) is None


@pytest.mark.parametrize("speed", [15.0, 45.0, -90.0])
def test_joints_that_miss_many_goals_are_told(speed):
    happened, to_check = told_in_silence(missed=True, ticks=7, speed=speed)
    assert happened == "missed its goals while no servo answered for 0.07 s, and is"
    assert "USB cable" in to_check


def off_after_late_ticks(joint_speed, gap, since):
    """How far a joint at 120 deg/s is off that ran on for ``gap`` [s] without setpoints [deg].

    Its setpoints go on for ``since`` [s] then; the joint keeps ``joint_speed`` [deg/s] meanwhile.
    """
    check, speed = FollowingCheck(TOLERANCES, DT), np.radians([120.0])
    check.begin(np.zeros(1))
    for k in range(50):
        check.want(k * DT * speed)
        check.off(k * DT * speed)
    wanted = 49 * DT * speed
    check.run_on(wanted, speed, gap)
    joint = wanted + gap * np.radians([joint_speed])
    for _ in range(round(since / DT)):
        wanted, joint = wanted + DT * speed, joint + DT * np.radians([joint_speed])
        check.want(wanted)
        off = check.off(joint)
    return float(np.degrees(off[0])), check.words(0, held_up=False)


LATE, BUSY = "was without setpoints for {} s, and is", "how busy the computer is"


@pytest.mark.parametrize(
    ("joint_speed", "gap", "since", "off", "happened"),
    [
        (120.0, 0.1, DT, 1.2, LATE.format("0.10")),  # what it has run on since
        (140.0, 0.1, 0.25, 19.0, LATE.format("0.10")),
        (120.0, 0.1, 0.5, 12.0, "is"),
        # longer than servos need to their goals: beyond a tenth of a second, and since
        (120.0, 0.2, DT, 13.2, LATE.format("0.20")),
        (0.0, 0.05, 0.25, 12.0, "is"),  # stopped: behind all setpoints of the last 0.15 s
    ],
)
def test_a_joint_that_ran_on_without_setpoints_is_off_if_it_goes_on(
    joint_speed, gap, since, off, happened
):
    found, words = off_after_late_ticks(joint_speed, gap, since)
    assert found == pytest.approx(off)
    assert words[0] == happened
    assert (words[1] == BUSY) == (happened != "is")


# Leading the tool by hand


MODEL = RobotModel.load()
READY = np.radians([0.0, -30.0, 30.0, 35.0, 0.0])
LIMITS = MotionLimits.uniform(velocity=1.5, acceleration=3.0, jerk=100.0)


@pytest.fixture
def led(make_sim, taped_arm, clock):
    led = make_sim(taped_arm(clock, q=READY))
    led.executor.start()
    return led


def servo_of(led) -> Servo:
    return Servo(MODEL, CollisionModel(MODEL), LIMITS, led.dt, led.state.q_ref)


def lead(led, servo: Servo | None = None) -> Jog:
    return led.executor.play(Jog(servo or servo_of(led), led.dt, lambda: 0.0))


def repeat(led, jog: Jog, seconds: float, linear, **more) -> None:
    for _ in range(round(seconds / 0.1)):
        jog.twist(linear, **more)
        led.clock.advance(0.1)


def tool(q) -> SE3:
    return MODEL.frame(q)


def test_a_repeated_velocity_moves_the_tool_until_it_is_not_repeated(led) -> None:
    start, jog = tool(READY).p, lead(led)
    led.clock.advance(0.05)
    assert led.state.arm_moving
    repeat(led, jog, 1.0, [0.05, 0.0, 0.0])
    assert tool(led.state.q).p[0] > start[0] + 0.03
    led.clock.advance(1.0)
    where = led.state.q
    led.clock.advance(0.5)
    np.testing.assert_allclose(led.state.q, where, atol=1e-6)
    assert led.state.mode is Mode.MOVING
    assert tool(where).p[0] < start[0] + 0.05 * (1.0 + 0.25) + 0.01


def test_closing_brings_the_arm_to_rest_and_ends_the_jog(led) -> None:
    jog = lead(led)
    repeat(led, jog, 0.5, [0.0, 0.1, 0.0])
    led.after(2.0, jog.close())
    assert led.state.mode is Mode.HOLDING
    assert not led.state.arm_moving
    assert max(shares(led.arm.goals, led.dt, LIMITS)[:2]) <= 1.02
    with pytest.raises(MotionError, match="open a new one"):
        jog.twist([0.1, 0.0, 0.0])


def test_a_pose_or_point_is_reached_and_held_without_being_repeated(led) -> None:
    goal = tool(READY + np.array([0.3, 0.15, -0.1, 0.1, 0.2]))
    jog, p = lead(led), tool(READY).p + np.array([-0.04, 0.06, 0.02])
    jog.to_pose(goal)
    led.clock.advance(3.0)
    assert np.linalg.norm(tool(led.state.q).p - goal.p) < 2e-4
    np.testing.assert_allclose(tool(led.state.q).R, goal.R, atol=2e-3)
    jog.to_point(p.tolist())
    led.clock.advance(3.0)
    assert np.linalg.norm(tool(led.state.q).p - p) < 2e-4
    led.after(1.0, jog.close())


def test_stop_ends_a_jog_along_its_path_and_harder_than_it_would(led) -> None:
    servo = servo_of(led)
    jog = lead(led, servo=servo)
    repeat(led, jog, 0.6, [0.0, 0.15, 0.05])
    ahead = servo.path_to_rest()[1:]
    stopped = led.executor.stop()
    led.after(2.0, stopped)
    assert isinstance(jog.future.exception(), Interrupted)
    rest = led.state.q_ref
    assert np.abs(ahead - rest).max(axis=1).min() < 1e-3
    assert np.abs(rest - ahead[0]).max() < np.abs(ahead[-1] - ahead[0]).max()
    assert max(shares(led.arm.goals, led.dt, led.stop_limits)[:2]) <= 1.02
    with pytest.raises(Interrupted):
        jog.twist([0.1, 0.0, 0.0])


@pytest.mark.parametrize(
    ("what", "bad"),
    [("linear", bad) for bad in ([0.1, 0.2], [np.nan, 0.0, 0.0], "fast", None)]
    + [("p_base", bad) for bad in ([100.0, 200.0, 300.0], [np.nan, 0.0, 0.0], [0.1, 0.2], "there")],
)
def test_what_is_no_velocity_or_no_point_is_refused(led, what, bad) -> None:
    jog = lead(led)
    with pytest.raises(ConfigError, match=what):
        (jog.twist if what == "linear" else jog.to_point)(bad)


def test_the_arm_is_jogged_no_further_than_it_can_hold_what_it_carries(clock) -> None:
    with open_simulated(clock=clock, q_start=READY) as rig:
        arm = rig.arm
        arm.set_load(LoadConfig(mass=0.2))
        jog = arm.jog()
        for _ in range(40):
            jog.twist([0.1, 0.0, 0.0])
            clock.advance(0.1)
        assert jog.held_by == ("shoulder_lift at its torque limit",)
        further = arm.T_base().p + np.array([0.03, 0.0, 0.0])
        with pytest.raises(Overloaded, match="at the goal"):
            arm.plan(PoseGoal.at_point(further))
        with pytest.raises(ConfigError, match="not fixed to the gripper"):
            arm.jog(frame="elbow")


class Unbraked(Jog):
    """A jog whose way to rest cannot be computed."""

    def brake(self, now, limits):
        raise ArithmeticError("no way to rest")


def test_a_stop_that_fails_leaves_nobody_waiting_and_nothing_moving(led, caplog) -> None:
    jog = led.executor.play(Unbraked(servo_of(led), led.dt, lambda: 0.0))
    repeat(led, jog, 0.5, [0.05, 0.0, 0.0])
    caplog.set_level(logging.CRITICAL, logger="so101_motion.control.joint_controller")
    here = led.state.q_ref
    asked = [led.executor.stop(), led.executor.call(lambda driver: 1), led.executor.stop()]
    led.clock.advance(0.05)
    assert all(future.done() for future in asked)
    assert isinstance(asked[0].exception(), ArithmeticError)
    assert isinstance(jog.future.exception(), ArithmeticError)
    assert led.state.mode is Mode.FAULT
    led.clock.advance(0.5)
    np.testing.assert_array_equal(led.state.q_ref, here)
