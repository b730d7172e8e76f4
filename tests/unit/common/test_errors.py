import pickle
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

from so101_motion.cli.error_exit import reports_errors
from so101_motion.common import errors
from so101_motion.common.errors import So101Error

ONE_OF_EACH = [
    errors.ConfigError("speed", 200.0, "must be between 3 and 180 deg/s"),
    errors.ArmClosed(),
    errors.ChoiceNeeded("arm", None, "the machine has several; name one of left, right"),
    errors.Unreachable(
        "too far",
        error_position=0.05,
        error_angle=0.0,
        p_base_nearest=np.array([0.3, 0.0, 0.1]),
        q_nearest=np.zeros(5),
        limit="full stretch",
    ),
    errors.OutsideLimits("elbow", joint="elbow_flex", value=2.0, lower=-1.69, upper=1.58),
    errors.InCollision("hits", first="gripper", second="floor", where="goal"),
    errors.Overloaded("heavy", joint="shoulder_lift", torque=1.5, limit=1.1, q=np.zeros(5)),
    errors.NoPath("no way"),
    errors.BusError("no reply"),
    errors.PortUnavailable("/dev/ttyACM0", "in use by another program; end it first"),
    errors.NotReady("servo 3 does not answer, tried for 12 s"),
    errors.NotPossibleNow("save", "the travels are not known yet"),
    errors.NoReply("silent", servo_id=3, register="present_position"),
    errors.CorruptReply("garbled", raw=b"\xff\xff\x03"),
    errors.ServoFault("overloaded", servo_id=3, flags=0x20),
    errors.CommandRefused("too far at once", joint="elbow_flex"),
    errors.OtherCalibration(Path("arm.json"), "arm.json is another arm's"),
    errors.Interrupted("stop"),
    errors.NotHolding("limp"),
    errors.FollowingError("stuck", joint="elbow_flex", error=0.2, recent=()),
    errors.ServoAlarm("elbow_flex", "71 degC; let it cool", recent=()),
    errors.CalibrationError("elbow_flex", "too narrow", "calibrate again"),
    errors.MotorSetupError("gripper", "no servo", "none answers", "switch the power on"),
    errors.MachineUnavailable("10.0.0.7:8080", "does not answer; is it running?"),
    errors.SurroundingsUnknown('"crate" does not tell its geometries', component="crate"),
    errors.MachineRefused("the motion", "ABORTED", "ended early by stop"),
    errors.WorkerError("died"),
]


def concrete(cls):
    below = cls.__subclasses__()
    return {cls} | {deeper for sub in below for deeper in concrete(sub)}


def test_every_error_has_an_example_here():
    families = {errors.So101Error, errors.PlanningError, errors.MotionError}
    ours = {cls for cls in concrete(So101Error) if cls.__module__ == errors.__name__}
    assert ours - families == {type(error) for error in ONE_OF_EACH}


@pytest.mark.parametrize("error", ONE_OF_EACH, ids=lambda error: type(error).__name__)
def test_errors_cross_a_process_boundary_with_all_their_fields(error):
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is type(error)
    assert str(copy) == str(error)
    assert copy.__dict__.keys() == error.__dict__.keys()
    for name, value in error.__dict__.items():
        np.testing.assert_array_equal(getattr(copy, name), value)


@pytest.mark.parametrize("error", ONE_OF_EACH, ids=lambda error: type(error).__name__)
def test_every_error_is_reported_in_lines_and_with_an_exit_code_of_its_own(error):
    @click.command()
    @reports_errors()
    def fails():
        raise error

    result = CliRunner().invoke(fails)
    lines = result.stderr.splitlines()
    assert lines[0].startswith("error: ")
    assert len(lines[0]) > len("error: ")
    assert all(line.startswith(("  why: ", "  try: ")) for line in lines[1:])
    assert result.exit_code in (1, 2, 3, 4, 5, 6, 7)
    assert (result.exit_code == 1) == isinstance(error, errors.WorkerError)


@pytest.mark.parametrize(
    "value",
    [
        "é" * 1_000_000,
        b"\xff" * 1_000_000,
        list(range(1_000_000)),
        dict.fromkeys(range(1_000_000)),
        {"a" * 1_000_000: ["b" * 1_000_000] * 1_000},
        10**4_000,
        np.zeros((1_000, 1_000)),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_message_quotes_the_ends_of_a_long_value(value):
    error = errors.ConfigError("k" * 1_000_000, value, "must be short; send less")
    assert len(errors.quoted(value)) <= errors.LONGEST_QUOTE
    assert len(str(error)) < 300
    assert str(error).endswith("must be short; send less")


def test_a_long_message_keeps_its_beginning_and_its_advice():
    error = errors.NoPath("no way, says the planner " + "and says " * 100_000 + "; move nearer")
    assert len(str(error)) == errors.LONGEST_MESSAGE
    assert str(error).startswith("no way")
    assert str(error).endswith("; move nearer")


@pytest.mark.parametrize("value", ["mug", 1.5, [1, 2, 3], {"b": 1, "a": 2}, (), None, True, "é\n"])
def test_a_short_value_is_quoted_as_it_is(value):
    assert errors.quoted(value) == repr(value)


def test_what_an_error_quotes_of_a_file_cannot_steer_a_terminal():
    error = errors.CalibrationError("", "the file says \x1b[2Jdone\x7f\nand é", "look at it")
    assert str(error) == r"the file says \x1b[2Jdone\x7f\nand é; look at it"
    assert str(error.about("a\x07")) == rf"a\x07: {error}"
