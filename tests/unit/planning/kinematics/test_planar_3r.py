"""The closed forms of the plane against its own forward kinematics and against brute force."""

import math

import numpy as np
import pytest

from so101_motion.planning.kinematics.planar_3r import TAU, Bars, Hand, Target, ThreeBars

BARS = Bars(
    upper_arm=0.116,
    upper_arm_elevation=1.327,
    forearm=0.135,
    forearm_elevation=0.0385,
    lower=(-1.745, -1.690, -1.658),
    upper=(1.745, 1.585, 1.658),
)
HANDS = [Hand(0.0611, 0.0), Hand(0.1594, -0.05), Hand(0.03, 1.2)]


@pytest.fixture
def bars():
    return ThreeBars(BARS)


def configurations(n, seed=0):
    return np.random.default_rng(seed).uniform(BARS.lower, BARS.upper, (n, 3)).tolist()


def target_of(bars, angles, hand):
    return Target(*bars.points(tuple(angles), hand)[-1], hand)


def distance(angles, seed):
    return math.dist(angles, seed)


@pytest.mark.parametrize("hand", HANDS)
def test_every_bend_ends_at_the_target_and_the_wanted_one_is_among_them(bars, hand):
    for angles in configurations(300):
        target = target_of(bars, angles, hand)
        bends = bars.bends(target, sum(angles))
        assert any(distance(bend.angles, angles) < 1e-5 for bend in bends)
        for bend in bends:
            end = bars.points(bend.angles, hand)[-1]
            assert math.dist(end, target[:2]) < 1e-12
            assert bars.allows(bend.angles)


def test_elbow_up_and_down_are_on_either_side_of_the_line_to_the_wrist(bars):
    hand = HANDS[0]
    target = target_of(bars, (0.5, bars.straight - 0.2, 0.3), hand)
    bends = bars.bends(target, 0.5 + bars.straight - 0.2 + 0.3)
    assert {bend.elbow_up for bend in bends} == {True, False}
    for bend in bends:
        _, elbow, wrist, _ = bars.points(bend.angles, hand)
        above = elbow[1] * wrist[0] - elbow[0] * wrist[1]
        assert (above > 0.0) == bend.elbow_up


def test_out_of_the_links_reach_there_is_no_bend(bars):
    far = Target(0.4, 0.0, HANDS[0])
    assert bars.bends(far, 0.0) == []
    assert bars.nearest_pitch(far, 0.0) == []


def test_a_micrometre_beyond_reach_is_met_with_a_straight_arm(bars):
    hand = HANDS[0]
    lift, wrist = 0.8, 0.4
    x, z = bars.points((lift, bars.straight, wrist), hand)[-1]
    scale = 1.0 + 1e-6 / math.hypot(x, z)
    pitch = lift + bars.straight + wrist
    (bend,) = bars.bends(Target(x * scale, z * scale, hand), pitch)
    assert bend.angles[1] == pytest.approx(bars.straight)


def is_bent(bars, target, pitch, elbow_up):
    return any(bend.elbow_up == elbow_up for bend in bars.bends(target, pitch))


@pytest.mark.parametrize("hand", HANDS)
@pytest.mark.parametrize("elbow_up", [True, False])
def test_within_an_interval_no_posture_appears_or_vanishes(bars, hand, elbow_up):
    for angles in configurations(40, seed=1):
        target = target_of(bars, angles, hand)
        for _, low, high in bars.intervals(target, 0.0, elbow_up):
            margin = 1e-3 * (high - low)
            inside = np.linspace(low + margin, high - margin, 12)
            assert len({is_bent(bars, target, pitch, elbow_up) for pitch in inside}) == 1


@pytest.mark.parametrize("hand", HANDS)
@pytest.mark.parametrize("elbow_up", [True, False])
def test_outside_all_intervals_there_is_no_posture(bars, hand, elbow_up):
    grid = np.linspace(-math.pi, math.pi, 181)
    for angles in configurations(40, seed=7):
        target = target_of(bars, angles, hand)
        for pitch in grid:
            gaps = [gap for gap, _, _ in bars.intervals(target, pitch, elbow_up)]
            if is_bent(bars, target, pitch, elbow_up):
                # Configuration and interval each have their slack at a limit that is only touched.
                assert min(gaps) < 1e-2


def test_intervals_come_nearest_first(bars):
    target = target_of(bars, (0.1, 0.2, 0.3), HANDS[1])
    gaps = [gap for gap, _, _ in bars.intervals(target, 0.6, True)]
    assert gaps == sorted(gaps)
    assert gaps[0] == 0.0


@pytest.mark.parametrize("hand", HANDS)
def test_the_nearest_pitch_is_no_farther_than_any_on_a_grid(bars, hand):
    rng = np.random.default_rng(2)
    grid = np.linspace(-math.pi, math.pi, 721)
    for angles in configurations(25, seed=3):
        target = target_of(bars, angles, hand)
        wish = rng.uniform(-3.0, 3.0)
        found = min(
            abs(math.remainder(sum(b.angles) - wish, TAU)) for b in bars.nearest_pitch(target, wish)
        )
        best = min(
            (abs(math.remainder(p - wish, TAU)) for p in grid if bars.bends(target, p)),
            default=math.inf,
        )
        # Where a limit is only touched, the slack of a joint moves the pitch by its square root.
        assert found <= best + 1e-3
