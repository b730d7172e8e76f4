"""The accuracy of a joint computed from invented states of test motions."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS, JointReading, JointState
from so101_motion.common.units import to_rad
from so101_motion.setup.move_test import JointAccuracy, Measurements, MoveReport


def state(t, *, q, q_ref, qd_ref, moving=True):
    """The arm with its first joint somewhere."""
    first = np.array([1.0, 0, 0, 0, 0])
    return JointState(
        t=t,
        mode=Mode.MOVING,
        reading=JointReading(q=q * first, qd=np.zeros(5), q_jaw=0.0, qd_jaw=0.0),
        q_ref=q_ref * first,
        qd_ref=qd_ref * first,
        q_jaw_ref=0.0,
        arm_moving=moving,
        jaw_moving=False,
        late_ticks=0,
    )


def ramp(lag, *, speed=0.2, duration=1.0, settles=0.0):
    """A joint that runs at ``speed`` and is late by ``lag``, then takes a while to settle."""
    times = np.arange(0.0, duration, 0.01)
    states = [
        state(t, q=speed * (t - lag), q_ref=speed * t, qd_ref=speed) for t in times
    ]  # fmt: skip
    end = speed * duration
    rest = np.arange(duration, duration + settles, 0.01)
    return states + [state(t, q=end, q_ref=end, qd_ref=0.0) for t in rest]


@given(st.floats(0.001, 0.5), st.floats(0.01, 2.0), st.booleans())
def test_the_lag_is_that_of_the_joint_whichever_way_it_runs(lag, speed, backwards):
    measured = Measurements("shoulder_pan")
    measured.note_motion(0, ramp(lag, speed=-speed if backwards else speed))
    measured.note_stop(0.0, 0.0, is_from_below=True)
    assert measured.accuracy().lag == pytest.approx(lag, rel=1e-6)


def test_an_arm_that_does_not_tell_setpoints_apart_has_no_lag_and_no_settling():
    measured = Measurements("shoulder_pan")
    measured.note_motion(0, ramp(0.0))
    measured.note_stop(0.1, 0.1, is_from_below=True)
    found = measured.accuracy()
    assert (found.lag, found.settle, found.error) == (None, None, 0.0)


def test_settling_is_counted_from_the_end_of_the_reference():
    measured = Measurements("shoulder_pan")
    measured.note_motion(0, ramp(0.05, settles=0.3))
    assert measured.accuracy().settle == pytest.approx(0.3, abs=0.011)


def test_stops_in_one_place_are_compared_by_the_side_they_were_reached_from():
    measured = Measurements("shoulder_pan")
    for wanted, here, is_from_below in (
        (0.1, 0.103, True), (0.0, 0.002, False), (-0.1, -0.1, False), (0.0, -0.003, True),
    ):  # fmt: skip
        measured.note_stop(wanted, here, is_from_below=is_from_below)
    found = measured.accuracy()
    assert found.hysteresis == pytest.approx(0.005)
    assert found.error == pytest.approx(0.003)


@pytest.mark.parametrize(
    ("found", "verdict", "words"),
    [
        (JointAccuracy(joint="elbow_flex", error=0.001), "ok", ""),
        (JointAccuracy(joint="elbow_flex", error=to_rad(1.0)), "warn", "stops short"),
        (JointAccuracy(joint="elbow_flex", error=to_rad(2.0)), "fail", "stops short"),
        (JointAccuracy(joint="gripper", error=to_rad(2.0)), "ok", ""),
        (JointAccuracy(joint="elbow_flex", error=0.0, lag=0.2), "warn", "it lags"),
        (JointAccuracy(joint="elbow_flex", error=0.0, settle=3.0), "fail", "settles slowly"),
        (JointAccuracy(joint="elbow_flex", error=0.0, hysteresis=0.02), "warn", "play"),
        (JointAccuracy(joint="elbow_flex", error=0.0, trouble="hot"), "fail", "hot"),
        (JointAccuracy(joint="elbow_flex"), "not tested", ""),
    ],
)
def test_a_joint_is_judged_by_its_worst_figure(found, verdict, words):
    assert found.verdict == verdict
    assert words in found.sentence


WELL = MoveReport(
    arm="arm on /dev/a",
    joints=tuple(JointAccuracy(joint=joint, error=0.001, tool=0.001) for joint in ARM_JOINTS),
    began_at="2026-01-02T03:04:05+00:00",
    seconds=20.0,
)


def test_a_report_passes_when_all_joints_obey_and_nobody_saw_otherwise():
    assert WELL.passed
    assert replace(WELL, as_shown=True).passed
    assert not replace(WELL, as_shown=False).passed
    assert "may be swapped" in replace(WELL, as_shown=False).sentence
    assert not replace(WELL, ended_by="stop").passed
    untested = (*WELL.joints[:4], JointAccuracy(joint="wrist_roll"))
    assert replace(WELL, joints=untested).sentence == "Failed: wrist_roll"


def test_a_report_is_the_same_as_text_and_as_json():
    told = json.loads(WELL.file({"version": "1"}))
    assert told["schema"] == "so101/move-test/1"
    assert told["passed"] is True
    assert told["tool_mm"] == 1.0
    assert [joint["joint"] for joint in told["joints"]] == list(ARM_JOINTS)
    text = WELL.text()
    assert text.startswith("Passed: all joints move as commanded.\n")
    assert all(joint in text for joint in ARM_JOINTS)


def test_what_is_wrong_with_several_joints_is_said_once_under_the_table():
    first, second, *others = WELL.joints
    stuck = [replace(joint, error=to_rad(3.0)) for joint in (first, second)]
    text = replace(WELL, joints=(*stuck, *others)).text()
    assert text.count("it stops short") == 1
    assert text.splitlines()[-1].startswith(f"{first.joint}, {second.joint}: it stops short")
    assert "it stops short" not in WELL.text()
