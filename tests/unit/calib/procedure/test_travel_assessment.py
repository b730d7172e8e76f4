"""The verdicts on a recorded travel."""

import pytest

from so101_motion.calib.procedure.travel import (
    MIDDLE,
    TravelArc,
    TravelRecorder,
    Verdict,
    assess,
    can_be_accepted,
)
from so101_motion.calib.record import zero
from so101_motion.calib.record.record import JOINTS, default

DEG = 4096 / 360


def judged(joint, share=1.0, home=MIDDLE, **more):
    """What is said of ``share`` of the expected travel, its middle at ``MIDDLE``."""
    expected = round(zero.expected_travel(joint))
    travel = round(share * expected)
    arc = TravelArc(MIDDLE - travel // 2, travel) if travel else None
    return assess(joint, arc, expected=expected, home=home, **more)


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
        "moved 184 of 193 deg; press it gently against both its stops"
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


def test_a_servo_that_counts_down_is_named_before_it_has_moved():
    said = judged("elbow_flex", 0.0, counts_down=True)
    assert said.verdict is Verdict.WRONG_DIRECTION
    assert not said.is_usable


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5])
def test_a_roll_that_was_not_swept_counts_as_a_full_turn(share):
    said = judged("wrist_roll", share)
    assert (said.verdict, said.is_usable) == (Verdict.FULL_TURN, True)


def test_a_roll_swept_to_its_stops_keeps_them():
    assert judged("wrist_roll").verdict is Verdict.COMPLETE


def test_a_roll_whose_zero_is_far_off_its_middle_is_asked_about():
    expected = round(zero.expected_travel("wrist_roll"))
    said = assess("wrist_roll", TravelArc(100, expected), expected=expected, home=100 + 1000)
    assert said.is_usable
    assert "did the gripper open upwards?" in said.sentence


def test_a_roll_without_stops_counts_as_a_full_turn():
    expected = round(zero.expected_travel("wrist_roll"))
    said = assess("wrist_roll", TravelArc(0, 4095), expected=expected, home=MIDDLE)
    assert (said.verdict, said.is_usable) == (Verdict.FULL_TURN, True)


def test_a_roll_that_went_more_than_half_a_turn_to_one_side_needs_its_stops():
    expected = round(zero.expected_travel("wrist_roll"))
    said = assess("wrist_roll", TravelArc(-100, 2200), expected=expected, home=MIDDLE)
    assert (said.verdict, said.is_usable) == (Verdict.TOO_SHORT, False)
    assert "more than half a turn" in said.sentence


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
    expected = round(zero.expected_travel("wrist_roll"))
    out_of_reach = 4096 - expected
    sweep = TravelRecorder()
    ticks = [MIDDLE] * 3 + [*range(MIDDLE, MIDDLE + expected // 2, 20)]
    back = [*range(MIDDLE - expected // 2, MIDDLE - expected // 2 + 600, 20)]  # not seen on the way
    for t, tick in enumerate(ticks):
        sweep.feed(0.01 * t, tick % 4096)
    for t, tick in enumerate(back):
        sweep.feed(100.0 + 0.01 * t, tick % 4096)
    assert sweep.arc is not None
    said = assess("wrist_roll", sweep.arc, expected=expected, home=MIDDLE)
    assert (said.verdict, said.is_usable) == (Verdict.NOT_SEEN, False)
    assert "deg of its way were not seen; move it through all of its way" in said.sentence
    assert not can_be_accepted(said.verdict, sweep.arc.travel)
    assert sweep.arc.hole >= 0.9 * out_of_reach  # it was the other way round

    for t, tick in enumerate(range(back[-1], MIDDLE + 100, 20)):
        sweep.feed(100.3 + 0.01 * t, tick % 4096)
    assert sweep.arc.hole == 0
    said = assess("wrist_roll", sweep.arc, expected=expected, home=MIDDLE)
    assert said.verdict in (Verdict.COMPLETE, Verdict.ALMOST)


def test_a_small_hole_costs_nothing():
    expected = round(zero.expected_travel("wrist_roll"))
    arc = TravelArc(MIDDLE - expected // 2, expected, (4096 - expected) // 3)
    assert assess("wrist_roll", arc, expected=expected, home=MIDDLE).is_usable
    pan = round(zero.expected_travel("shoulder_pan"))
    arc = TravelArc(MIDDLE - pan // 2, pan, 600)
    assert assess("shoulder_pan", arc, expected=pan, home=MIDDLE).is_usable
