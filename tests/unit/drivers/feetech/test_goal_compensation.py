import math
from dataclasses import replace

import numpy as np
import pytest
from harness.emulated_joints import MAPS
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.protocol import sync_write_packet
from so101_motion.drivers.bus.ticks import RAD_PER_TICK, TICKS_PER_RAD
from so101_motion.drivers.emulator.motion import Profile
from so101_motion.drivers.feetech.goal_compensation import LIMP, GoalCompensation
from so101_motion.drivers.feetech.lag_compensation import BRAKING, DELAY, braking
from so101_motion.drivers.feetech.servo_model import ServoModel
from so101_motion.drivers.goal_limiter import SIX, GoalLimiter
from so101_motion.drivers.servo_types import STS3215_7V4, STS3215_12V, ServoFigures
from so101_motion.native.library import quick

NAMES = tuple(MAPS)
LIFT = NAMES.index("shoulder_lift")


class Driven:
    """Six joints that start at ``q``; the second is commanded, every 10 ms."""

    def __init__(self, gravity=lambda q: np.zeros(6), q=0.0, servos=MAPS):
        limiter = GoalLimiter(NAMES, speed=math.pi, acceleration=10.0)
        self.servo = dict(servos)[NAMES[LIFT]]
        self.joint = GoalCompensation(dict(enumerate(servos.values())), gravity, limiter, None, {})
        self.k, self.q = 0, [q] * 6
        self.joint.begin(self.q, self.q, 0.0, ())

    def send(self, qd, qdd=None, **how):
        """Go on at ``qd`` [rad/s]; how far the goal is beyond the command [rad]."""
        self.k += 1
        self.q = [*self.q]
        self.q[LIFT] += 0.01 * qd
        rates, changes = [0.0] * 5, [0.0] * 5
        rates[LIFT], changes[LIFT] = qd, qdd or 0.0
        told = None if qdd is None else changes
        t = 0.01 * self.k
        self.joint.point(self.q, rates, t, SIX(*[math.nan] * 6), (), told, **how)
        goals = self.joint.goals(t)
        return self.servo.to_rad(goals[self.servo.servo_id]) - self.q[LIFT]


def followed(*, behind_deg, seconds):
    """What the trim has learnt after a lift at 50 deg/s behind a target, late by so much [deg]."""
    arm, speed = Driven(lambda q: np.eye(6)[LIFT]), math.radians(50.0)  # [N m]
    for k in range(1, round(seconds / 0.01)):
        qd = min(10.0 * 0.01 * k, speed)
        arm.send(qd)
        at, rates = [*arm.q], [0.0] * 6
        at[LIFT] -= math.radians(behind_deg) * min(0.01 * k / 0.1, 1.0)
        rates[LIFT] = qd
        arm.joint.trim.measure(SIX(*at), SIX(*rates), 0b111111, 0.01 * k)
    return math.degrees(arm.joint.trim.learnt[LIFT])


def test_what_a_joint_that_follows_a_target_lacks_beyond_its_lag_is_weight_and_its_lag_is_not():
    assert abs(followed(behind_deg=3.0, seconds=1.0)) < 0.3  # as emulated servos lag
    assert followed(behind_deg=4.5, seconds=0.5) > 1.0


def ahead_deg(
    speed_deg, *, follows_target=True, told_from=0.0, told=0.0, slows=False, told_until=9.9
):
    """How far ahead the goal of a joint is that has come up to this speed [deg].

    Its acceleration is known from ``told_from`` to ``told_until`` [s], and is said to be ``told``
    [rad/s^2] once it is at that speed. One that ``slows`` has done so for the last 0.15 s.
    """
    arm, speed, qd = Driven(q=-1.5), math.radians(speed_deg), 0.0
    for k in range(1, 101):
        qdd = -6.0 if slows and k > 85 else 5.0 if qd < speed else told
        known = qdd if told_from < 0.01 * k < told_until else None
        ahead = arm.send(qd, known, follows_target=follows_target)
        qd = max(min(qd + 0.01 * qdd, speed), 0.0)
    return math.degrees(ahead)


def test_a_slow_joint_that_follows_a_target_is_driven_less_far_ahead_and_a_fast_one_bounded():
    assert ahead_deg(20.0) < ahead_deg(20.0, follows_target=False) - 0.15
    assert abs(ahead_deg(80.0) - ahead_deg(80.0, follows_target=False)) < 0.1
    assert ahead_deg(175.0, follows_target=False, told=8.0) > 45.0
    assert ahead_deg(175.0, told=8.0) < 40.1


def test_one_that_follows_a_target_is_not_overtaken_as_more_is_known_nor_runs_on_as_it_slows():
    assert ahead_deg(80.0, told_from=0.5) == pytest.approx(ahead_deg(80.0, told_from=math.inf))
    assert ahead_deg(80.0, told_from=0.5) < ahead_deg(80.0) - 3.0
    known = ahead_deg(120.0, slows=True)
    assert ahead_deg(120.0, slows=True, told_until=0.855) < known + 0.2


def test_what_the_firmware_drops_of_its_set_point_is_added_towards_higher_ticks():
    for direction in (1, -1):
        beyond = 0.0
        for way in (1.0, -1.0):
            servos = {name: replace(map_, direction=direction) for name, map_ in MAPS.items()}
            arm, qd = Driven(servos=servos), 0.0
            for k in range(1, 101):
                qdd = way * (5.0 if k <= 20 else 0.0)
                qd += 0.01 * qdd
                beyond += arm.send(qd, qdd) * (k > 30) / 140.0
        # Ahead by the same both ways, but for what is dropped.
        assert direction * beyond == pytest.approx(0.5 * RAD_PER_TICK, rel=0.2)


def test_a_joint_whose_motor_is_driven_through_the_play_may_stand():
    """Its weight changes sides so fast that no unknown load is needed to take it through."""
    arm, qd = Driven(lambda q: math.copysign(0.5, q[LIFT] - 0.1) * np.eye(6)[LIFT]), 0.0
    joint = arm.joint
    joint.trim.put(LIFT, ServoModel(figures=ServoFigures(play=math.radians(0.8))))
    may_stand, kept = [], []
    for _ in range(1, 100):
        qdd = 2.0 if qd < 0.3 else 0.0
        qd += 0.01 * qdd
        arm.send(qd, qdd)
        may_stand.append(LIFT in joint.in_play()[0])
        kept.append(LIFT not in joint.trim.in_play())
    assert all(kept)
    assert 5 <= sum(may_stand[20:]) <= 8, "while its motor crosses the play, and not after"


# When joints of a plan turn round: where friction changes sign and motors cross their play

DT, PLAY = 0.01, math.radians(0.85)
TURNS = np.radians(200.0) * (0.5 - DT * np.arange(120))
"""Speeds of a joint that turns round at 0.5 s [rad/s]."""


class Turning:
    """Six joints without caps; the first moves as planned, every 10 ms."""

    def __init__(self, weight=lambda: 0.0, *, play=PLAY, kind=STS3215_12V):
        limiter = GoalLimiter(NAMES, speed=100.0, acceleration=1e9)
        self.joint = GoalCompensation(
            dict(enumerate(MAPS.values())), lambda q: weight() * np.eye(6)[0], limiter, None, {}
        )
        self.joint.trim.put(0, ServoModel(kind, figures=ServoFigures(play=play)))
        self.t, self.q = 0.0, 0.0
        self.joint.begin([0.0] * 6, [0.0] * 6, 0.0, ())

    def go(self, speed, change, dt=DT):
        """One command; the way of friction and how fast the motor goes through the play."""
        self.t, self.q = self.t + dt, self.q + dt * speed
        rates, changes = [speed, 0.0, 0.0, 0.0, 0.0], [change, 0.0, 0.0, 0.0, 0.0]
        here = [self.q, 0.0, 0.0, 0.0, 0.0, 0.0]
        self.joint.point(here, rates, self.t, SIX(*here), (), changes)
        return self.joint.trim.ways[0], self.joint.crossing[0]


def turned(speeds, *, weights=None, **servo):
    """The ways of friction, and how fast the motor goes through the play, of joint 0 at times."""
    loads = iter([weights[0], *weights] if weights is not None else [0.0] * 200)
    arm = Turning(lambda: next(loads), **servo)
    changes = (np.array(speeds)[6:] - np.array(speeds)[:-6]) / (6 * DT)
    seen = [arm.go(speed, change) for speed, change in zip(speeds, changes, strict=False)]
    return np.array(seen).T


def test_friction_changes_sides_before_the_joint_turns_and_is_done_soon_after():
    ways, _ = turned(TURNS)
    felt = ways[: round((0.5 - DELAY - 0.022) / DT)]
    assert felt[-6] == 1.0
    assert felt[-1] < 0.5
    assert ways[50] == -1.0


def test_the_motor_goes_through_all_of_the_play_and_no_further():
    _, crossing = turned(TURNS)
    assert DT * crossing[crossing < 0.0].sum() == pytest.approx(-PLAY)
    assert DT * crossing[crossing > 0.0].sum() == pytest.approx(0.5 * PLAY), "from the middle"


def test_a_joint_that_comes_to_rest_keeps_its_friction_where_it_is():
    t = DT * np.arange(150)
    smooth = 3.0 * np.minimum(t, 0.1) - np.minimum(t, 0.1) ** 2  # it has speeded up
    speeds = np.where(t < 0.5, smooth, 0.29 * np.maximum(1.0 - (t - 0.5) / 0.4, 0.0) ** 2)
    ways, _ = turned(speeds)
    assert ways[20:].min() == 1.0


def test_a_joint_crosses_its_play_where_its_load_changes_sides_and_not_where_it_turns():
    _, crossing = turned(TURNS, weights=np.full(120, 0.5))
    assert not crossing[10:].any()
    speeds = np.full(120, 0.5)
    _, crossing = turned(-speeds, weights=np.linspace(-0.5, 0.5, 120))
    assert DT * crossing[20:].sum() == pytest.approx(PLAY)
    assert crossing.max() < math.radians(4.0), "or it would stand if the load were another"


RECORDED = {
    (STS3215_12V, True, False): (2026892705, -0.03705177226201417, 0.003069455461103465,
        0.004659846735709924, -0.02649321934687338, 0.003175705706094444, -0.29497176850139134),
    (STS3215_7V4, True, True): (2032799893, -0.046250161752166, 0.03456445408445258,
        0.026009793340228134, -0.022571138470465244, 3.3344305082560314e-05, -0.09519052656622952),
    (STS3215_12V, False, True): (2020976476, -0.040762634320737935, -0.0025897601439444484,
        -0.010753657140839838, -0.04482495872590518, -2.2302475438240648e-05, -0.4),
}  # fmt: skip
"""By type, whether accelerations are told, and whether it follows a target: a sum of the goals, the
offsets at the end [rad] and the mass carried [kg], of 1 December 2026. A change of what is learnt
changes them; nothing else may."""


@pytest.mark.parametrize(("kind", "told", "follows"), RECORDED)
def test_goals_and_what_is_learnt_are_what_they_were_before(kind, told, follows):
    limiter = GoalLimiter(NAMES, speed=4.0, acceleration=20.0)
    arms = np.array([0.0, 1.9, 1.1, 0.4, 0.02, 0.0])
    own, per_kg = (lambda q: arms * np.cos(q)), (lambda q: 2.0 * arms * np.cos(q))
    joint = GoalCompensation(dict(enumerate(MAPS.values())), own, limiter, per_kg, {})
    for i in range(6):
        joint.trim.put(i, ServoModel(kind, figures=ServoFigures(play=0.014, friction=0.9)))
    q, k_sent = np.zeros(6), 0
    joint.begin(q.tolist(), q.tolist(), 0.0, ())
    for k in range(1, 301):  # all move; from 2 s on the fifth is held up, at 2.5 s all stop
        t, n, turns = 0.01 * k, 4 if k > 200 else 5, 0.01 * k * np.arange(1.0, 6.0)
        qd, qdd = 0.5 * np.sin(turns), 0.5 * np.arange(1.0, 6.0) * np.cos(turns)
        qd[n:] = math.nan
        if k < 250:
            q[:n] = (0.5 * (1.0 - np.cos(turns)) / np.arange(1.0, 6.0))[:n]
        moving = [qd.tolist(), qdd.tolist() if told else None] if k < 250 else [None, None]
        joint.point(q.tolist(), moving[0], t, SIX(*q), (), moving[1], follows_target=follows)
        goals = joint.goals(t)
        off = 0.01 * math.cos(t)
        joint.trim.measure(SIX(*(q - off)), SIX(), 0b111111, t + 0.004)
        k_sent += (k - 1) * sum(goals[i] * i for i in goals)
    sent, *learnt = RECORDED[kind, told, follows]
    assert k_sent == pytest.approx(sent, abs=1800), "a single one may round the other way"
    found = [*joint.trim.offset[:5], joint.trim.carried]
    np.testing.assert_allclose(found, learnt, rtol=0.0, atol=1e-12)


# Braking, and what the firmware drops


@given(qd=st.floats(-4.0, 4.0), acceleration=st.floats(1.0, 20.0))
def test_braking_over_the_stopping_distance_ends_at_rest(qd, acceleration):
    end = quick().so101_stopping_distance(qd, acceleration)
    assert math.copysign(1.0, end) == math.copysign(1.0, qd) or end == 0.0
    assert qd**2 - 2.0 * acceleration * abs(end) == pytest.approx(0.0, abs=1e-9)


@given(time=st.floats(0.0, 2.0), planned=st.floats(0.1, math.radians(460.0)))
def test_a_motion_that_brakes_more_gently_is_never_sent_beyond_its_end(time, planned):
    q, qd = -planned * time**2 / 2.0, planned * time  # its end is at zero
    assert q + quick().so101_stopping_distance(qd, min(BRAKING)) <= 1e-12


def test_a_raised_register_85_lets_servos_brake_harder_but_no_harder_than_the_cap():
    assert [braking(2, units) for units in (0, 50, 100)] == [BRAKING[2]] * 3, "as new or below"
    assert BRAKING[1] < braking(1, 120) < braking(1, 254) == math.radians(980.0)


@pytest.mark.parametrize("speed", [-1.5, -0.5, 0.5, 1.5])
def test_what_the_firmware_drops_of_a_set_point_on_its_way_is_known(speed):
    profile = Profile(2048.0)
    profile.speed = abs(speed) * TICKS_PER_RAD
    profile.acceleration, profile.target = 1e6, 2048.0 + math.copysign(900.0, speed)
    dropped = []
    for _ in range(300):
        profile.step()
        dropped.append(profile.position - int(profile.position))
    assert quick().so101_cut_off(speed) == pytest.approx(
        RAD_PER_TICK * sum(dropped) / 300.0, rel=0.05
    )


def test_the_packet_of_the_goals_is_the_one_of_a_sync_write_and_absent_servos_hold_theirs():
    joint, position = Driven(q=0.3).joint, reg.GOAL_POSITION
    goals = joint.goals(0.0)
    absent = goals.pop(MAPS[NAMES[LIFT]].servo_id)
    data = {servo_id: position.encode(ticks) for servo_id, ticks in goals.items()}
    assert joint.packet(position, 0.0, {LIFT}) == sync_write_packet(position.address, data)
    assert joint.held[:LIFT] == [*goals.values()][:LIFT]
    assert joint.held[LIFT] == LIMP != absent
    assert joint.packet(position, 0.0, range(6)) == b""
