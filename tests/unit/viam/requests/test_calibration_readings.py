import re
from dataclasses import replace
from pathlib import Path

import pytest

from so101_motion.calib.motors.setup_view import SetupView
from so101_motion.calib.procedure.steps import INSTRUCTIONS, OFFERED, State
from so101_motion.calib.procedure.travel import Verdict
from so101_motion.calib.procedure.view import CalibrationView, JointView
from so101_motion.calib.record.record import JOINTS
from so101_motion.setup.calibration_operation import ranges
from so101_motion.setup.calibrator import Situation
from so101_motion.viam.conversion import convert
from so101_motion.viam.models.calibration import COMMANDS, readings

ELBOW = JointView(
    joint="elbow_flex",
    servo_id=3,
    ticks=2150,
    homing_offset=-103,
    range_min=0,
    range_max=4095,
    recorded_min=758,
    recorded_max=2758,
    expected_deg=193.2,
    verdict=Verdict.TOO_SHORT,
    sentence="only 176° of its 193° recorded; move it on to both its stops",
    is_done=False,
)
UNKNOWN = replace(
    ELBOW, ticks=None, recorded_min=None, recorded_max=None, verdict=None, sentence=""
)


def situation(state=State.RECORDING, joint=ELBOW, **changes):
    view = CalibrationView(
        state=state,
        instruction=INSTRUCTIONS[state],
        joints={joint.joint: joint},
        commands=OFFERED[state],
        error=changes.pop("error", None),
        note=None,
        recording_time=15.3,
        samples=306,
    )
    now = Situation(
        view=view,
        setup=SetupView(),
        joints=view.joints,
        angles={},
        calibration_file="/data/arm.json",
        is_connected=True,
        holds=False,
        notes=(),
    )
    return replace(now, **changes)


def sent(now):
    """The readings as they go over the wire."""
    return convert.to_result(readings(now))


def test_a_recording_says_what_is_left_to_do():
    elbow = sent(situation())["joints"]["elbow_flex"]

    assert elbow["verdict"] == "too_short"
    assert elbow["recorded_range_degs"] == pytest.approx(175.8)
    assert elbow["expected_range_degs"] == 193.2
    assert "both its stops" in elbow["message"]


def test_what_is_not_known_has_no_key_and_errors_and_notes_are_reported():
    now = sent(situation(joint=UNKNOWN))

    assert "None" not in repr(now)
    assert "error" not in now
    assert "notes" not in now
    missing = {"current_position", "recorded_min", "recorded_max", "verdict", "message"}
    assert not missing & now["joints"]["elbow_flex"].keys()
    assert ranges({"elbow_flex": UNKNOWN}) == {}
    now = sent(situation(State.ERROR, error="no reply from servo 3", notes=("it is new",)))
    assert (now["error"], now["notes"]) == ("no reply from servo 3", ["it is new"])


def keys(value):
    """All keys of nested objects; those of joints are names."""
    if not isinstance(value, dict):
        return set()
    return set(value) | set().union(*map(keys, value.values()))


def test_the_page_for_owners_names_every_command_and_every_key():
    page = (Path(__file__).parents[4] / "docs" / "calibration.md").read_text()
    named = set(re.findall(r"`([a-z_]+)`", page))
    setup = SetupView().with_motor(replace(SetupView().motors["gripper"], sentence="found"))
    now = sent(situation(error="it", notes=("is",), setup=replace(setup, fix="this")))

    assert set(COMMANDS) | {"operation"} <= named
    assert keys(now) - set(JOINTS) - {"state"} <= named
    assert {state.value for state in State} | {verdict.value for verdict in Verdict} <= named
