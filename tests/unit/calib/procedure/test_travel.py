"""Travels on the circle of ticks, and homing offsets."""

from itertools import pairwise

import pytest

from so101_motion.calib.procedure.travel import (
    MIDDLE,
    TravelArc,
    TravelRecorder,
    Verdict,
    assess,
    can_be_accepted,
    fit,
    full_turn,
    homing_offset,
    representable,
)
from so101_motion.calib.record import zero
from so101_motion.calib.record.record import JOINTS, default


def swept(*ticks, dt=0.01):
    """A sweep that saw these readings, one every ``dt`` seconds."""
    sweep = TravelRecorder()
    for i, tick in enumerate(ticks):
        sweep.feed(i * dt, tick % 4096)
    return sweep


def line(*corners, step=25):
    """Readings on straight lines between corners, three at each."""
    ticks = [corners[0]] * 3
    for start, end in pairwise(corners):
        ticks += [*range(start, end, step if end > start else -step), end, end, end]
    return ticks


# Sweeps


@pytest.mark.parametrize(
    ("ticks", "arc"),
    [
        (line(4000, 4500, 3000), TravelArc(3000, 1500)),
        (line(100, 1500, -300), TravelArc(-300, 1800)),
        ([3900] * 3 + [300] * 3, TravelArc(-196, 496)),  # across the seam in one jump
        ([100] * 2, None),
        ([100] * 3, TravelArc(100, 0)),
        (line(0, 9000), TravelArc(1, 4095)),  # a whole turn and more
    ],
)
def test_a_sweep_goes_on_below_zero_and_above_4095(ticks, arc):
    assert swept(*ticks).arc == arc


def test_after_a_pause_the_way_in_between_is_unknown_until_it_is_passed():
    sweep = swept(*line(1000, 1100))
    for i in range(3):
        sweep.feed(10.0 + 0.01 * i, 3300)
    assert sweep.arc == TravelArc(3300 - 4096, 1896, 1795)  # the shorter of two guesses
    for i, ticks in enumerate(line(3300, 1000)):
        sweep.feed(10.03 + 0.01 * i, ticks)
    assert sweep.arc == TravelArc(1000, 2300)
    sweep = swept(*line(1000, 1100))
    for i in range(3):
        sweep.feed(0.3 + 0.01 * i, 1500)
    assert sweep.arc == TravelArc(1000, 500), "a short pause is bridged"


# Homing offsets


def test_offsets_are_a_tick_off_at_one_place_and_those_of_newer_firmware_have_an_equal():
    found = full_turn(offset=5, home=2047)
    assert (found.lower, found.upper, found.home) == (0, 4095, 2047)
    off = [encoder for encoder in range(4096) if (encoder - homing_offset(encoder)) % 4096 != 2047]
    assert off == [4095]
    assert representable(3000) == 3000 - 4096
    assert representable(-4000) == 96
    assert representable(2048) == 2047  # a tick off
    assert representable(-7) == -7


@pytest.mark.parametrize(
    ("lower", "offset", "fitted"),
    [
        (700, -150, (-150, 700, 2047)),
        (64, 0, (0, 64, 2047)),
        (-300, 1000, (3, 697, 3044)),  # across the seam, or next to it
        (10, 0, (-687, 697, 2734)),
        (4095 - 2710, 0, (688, 697, 1359)),
    ],
)
def test_a_travel_keeps_the_offset_of_the_pose_or_is_moved_to_the_middle(lower, offset, fitted):
    found = fit(TravelArc(lower, 2700), offset=offset, home=2047)
    assert (found.homing_offset, found.lower, found.home) == fitted
    assert found.upper == found.lower + 2700


DEG = 4096 / 360


def judged(joint, share, **more):
    """What is said of ``share`` of the expected travel, its middle at ``MIDDLE``."""
    expected = round(zero.expected_travel(joint))
    travel = round(share * expected)
    arc = TravelArc(MIDDLE - travel // 2, travel) if travel else None
    return assess(joint, arc, expected=expected, home=MIDDLE, **more)


@pytest.mark.parametrize("joint", [joint for joint in JOINTS if joint != "wrist_roll"])
@pytest.mark.parametrize(
    ("share", "verdict", "is_usable"),
    [
        (0.0, Verdict.UNTOUCHED, False),
        (0.01, Verdict.UNTOUCHED, False),
        (0.5, Verdict.TOO_SHORT, False),
        (0.75, Verdict.TOO_SHORT, False),
        (1.0, Verdict.COMPLETE, True),
        (1.2, Verdict.TOO_WIDE, False),
    ],
)
def test_a_travel_is_named_for_what_it_is(joint, share, verdict, is_usable):
    said = judged(joint, share)
    assert (said.verdict, said.is_usable) == (verdict, is_usable)
    assert said.sentence


def test_almost_is_usable_but_not_praised():
    assert judged("elbow_flex", 0.95).verdict is Verdict.ALMOST
    assert judged("elbow_flex", 0.95).is_usable
    assert judged("elbow_flex", 0.95).sentence == (
        "184° of its 193° recorded; press it gently against both its stops"
    )


@pytest.mark.parametrize("joint", zero.SWEPT)
def test_complete_is_what_the_joint_has_its_zero_from(joint):
    expected = round(zero.expected_travel(joint))
    for travel in range(expected - 80, expected + 80):
        said = assess(joint, TravelArc(500, travel), expected=expected, home=MIDDLE)
        entry = default(joint)
        by_stops = zero.by_stops(
            joint, type(entry)(id=entry.id, range_min=500, range_max=500 + travel)
        )
        if abs(travel - expected + 45) > 1 and abs(travel - expected - 57) > 1:  # but for rounding
            assert (said.verdict is Verdict.COMPLETE) == (by_stops is not None)
        assert said.is_usable


@pytest.mark.parametrize("span_deg", [109, 117, 128, 140])
def test_jaws_of_public_calibrations_are_usable(span_deg):
    arc = TravelArc(MIDDLE - 20, round(span_deg * DEG))
    expected = round(zero.expected_travel("gripper"))
    said = assess("gripper", arc, expected=expected, home=MIDDLE)
    assert said.is_usable
    assert said.verdict is Verdict.COMPLETE


def test_a_jaw_that_opens_towards_smaller_readings_is_named():
    travel = round(zero.expected_travel("gripper"))
    said = assess("gripper", TravelArc(MIDDLE - travel + 10, travel), expected=travel, home=MIDDLE)
    assert said.verdict is Verdict.WRONG_DIRECTION
    assert said.is_usable  # it may just have been open
    counts_down = judged("elbow_flex", 0.0, counts_down=True)
    assert (counts_down.verdict, counts_down.is_usable) == (Verdict.WRONG_DIRECTION, False)


ROLL = round(zero.expected_travel("wrist_roll"))


@pytest.mark.parametrize(
    ("arc", "home", "verdict", "is_usable", "words"),
    [
        (None, MIDDLE, Verdict.FULL_TURN, True, ""),
        (TravelArc(MIDDLE - ROLL // 10, ROLL // 5), MIDDLE, Verdict.FULL_TURN, True, ""),
        (TravelArc(MIDDLE - ROLL // 4, ROLL // 2), MIDDLE, Verdict.FULL_TURN, True, ""),
        (TravelArc(0, 4095), MIDDLE, Verdict.FULL_TURN, True, ""),
        (TravelArc(MIDDLE - ROLL // 2, ROLL), MIDDLE, Verdict.COMPLETE, True, ""),
        (TravelArc(100, ROLL), 1100, Verdict.COMPLETE, True, "did the gripper open upwards?"),
        (TravelArc(-100, 2200), MIDDLE, Verdict.TOO_SHORT, False, "more than half a turn"),
    ],
)
def test_a_roll_is_a_full_turn_or_has_its_stops(arc, home, verdict, is_usable, words):
    said = assess("wrist_roll", arc, expected=ROLL, home=home)
    assert (said.verdict, said.is_usable) == (verdict, is_usable)
    assert words in said.sentence


def test_only_a_travel_that_can_be_stored_can_be_accepted():
    def is_offered(arc):
        said = assess("elbow_flex", arc, expected=2000, home=MIDDLE)
        return can_be_accepted(said.verdict, 0 if arc is None else arc.travel)

    assert is_offered(TravelArc(1000, 900))
    assert is_offered(TravelArc(1000, 2500))
    assert not is_offered(None)
    assert not is_offered(TravelArc(0, 4095))


def test_a_hole_that_may_be_taken_for_the_part_out_of_reach_is_passed_again_first():
    """Or a roll whose readings paused while it moved would get the limits of that pause."""
    out_of_reach = 4096 - ROLL
    sweep = TravelRecorder()
    ticks = [MIDDLE] * 3 + [*range(MIDDLE, MIDDLE + ROLL // 2, 20)]
    back = [*range(MIDDLE - ROLL // 2, MIDDLE - ROLL // 2 + 600, 20)]  # not seen on the way
    for t, tick in enumerate(ticks):
        sweep.feed(0.01 * t, tick % 4096)
    for t, tick in enumerate(back):
        sweep.feed(100.0 + 0.01 * t, tick % 4096)
    assert sweep.arc is not None
    said = assess("wrist_roll", sweep.arc, expected=ROLL, home=MIDDLE)
    assert (said.verdict, said.is_usable) == (Verdict.NOT_SEEN, False)
    assert "° of its way; move it slowly through all of it again" in said.sentence
    assert not can_be_accepted(said.verdict, sweep.arc.travel)
    assert sweep.arc.hole >= 0.9 * out_of_reach  # it was the other way round

    for t, tick in enumerate(range(back[-1], MIDDLE + 100, 20)):
        sweep.feed(100.3 + 0.01 * t, tick % 4096)
    assert sweep.arc.hole == 0
    said = assess("wrist_roll", sweep.arc, expected=ROLL, home=MIDDLE)
    assert said.verdict in (Verdict.COMPLETE, Verdict.ALMOST)


def test_a_small_hole_costs_nothing():
    arc = TravelArc(MIDDLE - ROLL // 2, ROLL, (4096 - ROLL) // 3)
    assert assess("wrist_roll", arc, expected=ROLL, home=MIDDLE).is_usable
    pan = round(zero.expected_travel("shoulder_pan"))
    arc = TravelArc(MIDDLE - pan // 2, pan, 600)
    assert assess("shoulder_pan", arc, expected=pan, home=MIDDLE).is_usable
