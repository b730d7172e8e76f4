"""Verbs that fail: a sentence on stderr for people, JSON on stdout for programs."""

import errno
import json
import logging
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from so101_motion.cli.error_exit import KINDS, parted, reports_errors
from so101_motion.cli.shared import DEBUG, in_lines, print_json
from so101_motion.common.errors import CalibrationError, ConfigError, InCollision, PortUnavailable


def reported(result):
    content = json.loads(result.stdout)
    assert content["schema"] == "so101/error/1"
    assert content["exit_code"] == result.exit_code
    assert content["kind"] == KINDS[result.exit_code][0]
    return content


@pytest.mark.parametrize(
    ("arguments", "code", "error"),
    [
        ("plan --sim --joints 0,0,120,0,0", 5, "OutsideLimits"),
        ("plan --port /dev/no-such-port --pose ready", 3, "PortUnavailable"),
        ("status --machine 127.0.0.1:9", 3, "MachineUnavailable"),
        ("doctor --machine 127.0.0.1:9", 3, "MachineUnavailable"),
        ("status --port /dev/no-such-port", 3, "PortUnavailable"),
        ("calibrate --port /dev/no-such-port", 3, "PortUnavailable"),
        ("setup --port /dev/no-such-port", 3, "PortUnavailable"),
        ("calibration show none.json", 6, "CalibrationError"),
        ("run --sim none", 2, "ConfigError"),
        ("run --sim", 2, ""),
        ("status", 2, ""),
        ("stop", 2, ""),
        ("plan --sim --xyz 1,2", 2, ""),
        ("viam import none.json", 2, ""),
        ("no-such-verb", 2, ""),
        ("--no-such-option", 2, ""),
    ],
)
def test_with_json_a_program_gets_one_object_and_a_person_the_sentence(
    so101, arguments, code, error
):
    result = so101(f"{arguments} --json")
    assert result.exit_code == code, result.output
    content = reported(result)
    assert content["error"] == error
    assert content["what"]
    assert content["what"] in result.stderr
    for part in ("why", "try"):
        assert content[part] in result.stderr or error == ""


def test_a_refusal_to_agree_is_reported_as_json_too(so101):
    result = so101("move --sim --joints 5,0,0,0,0 --json", input="n\n")
    assert reported(result)["kind"] == "stopped"
    assert "nothing moved" in result.stderr


def test_a_verb_that_has_reported_its_error_is_not_reported_again(so101):
    result = so101("ports --port /dev/no-such-port --json")
    assert result.exit_code == 3
    assert json.loads(result.stdout)["schema"] == "so101/ports/1"

    @click.command()
    @reports_errors(as_json=True)
    def fails_late():
        print_json("plan", {})
        raise ConfigError("out", "x", "cannot be written")

    late = CliRunner().invoke(fails_late)
    assert late.exit_code == 2
    assert json.loads(late.stdout)["schema"] == "so101/plan/1"
    assert "cannot be written" in late.stderr


def test_ctrl_c_and_a_defect_are_reported_as_json(monkeypatch):
    @click.command()
    @click.argument("how")
    @reports_errors(as_json=True)
    def fails(how):
        # a codec that a signal ends gives it a message of its own
        raise KeyboardInterrupt("decoding failed") if how == "ctrl-c" else RuntimeError("oh")

    ended = reported(CliRunner().invoke(fails, ["ctrl-c"]))
    assert (ended["kind"], ended["why"]) == ("interrupted", "nothing moved")
    result = CliRunner().invoke(fails, ["defect"])
    defect = reported(result)
    assert (defect["kind"], defect["error"]) == ("unexpected", "RuntimeError")
    assert "unexpected: RuntimeError: oh" in result.stderr
    assert "Traceback" not in result.output
    monkeypatch.setenv(DEBUG, "1")
    assert isinstance(CliRunner().invoke(fails, ["defect"]).exception, RuntimeError)


def test_the_documented_exit_codes_exist():
    page = (Path(__file__).parents[3] / "docs" / "command-line.md").read_text()
    for code, (kind, _) in KINDS.items():
        assert f"| {code} | `{kind}` |" in page


def test_a_log_line_is_one_line_and_shows_a_traceback_only_on_request(capsys, monkeypatch):
    def trouble():
        with in_lines():
            try:
                raise RuntimeError("oh")
            except RuntimeError:
                logging.getLogger("so101_motion.control.executor").exception("a servo is silent")
        return capsys.readouterr().err

    assert trouble() == "a servo is silent\n"
    monkeypatch.setenv(DEBUG, "1")
    assert "Traceback" in trouble()


def test_a_full_disk_or_a_reader_who_closes_the_pipe_is_no_defect(capsys):
    with pytest.raises(SystemExit), reports_errors():
        raise OSError(errno.ENOSPC, "No space left on device")
    told = capsys.readouterr().err
    assert "No space left" in told
    assert "defect" not in told

    @click.command()
    @reports_errors()
    def tells():
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    result = CliRunner().invoke(tells)
    assert result.exit_code == 1
    assert result.output == ""


def test_an_error_is_printed_as_what_why_and_what_to_try():
    parts = parted(PortUnavailable("/dev/a", "in use by another program; end it first"))
    assert (parts.what, parts.why, parts.advice) == (
        "the port /dev/a cannot be used", "in use by another program", "end it first",
    )  # fmt: skip
    gone = PortUnavailable("/dev/a", "the port went away; plug it in").about("anna").about("step 2")
    assert parted(gone).what == "step 2: anna: the port /dev/a cannot be used"
    assert (parted(gone).why, parted(gone).advice) == ("the port went away", "plug it in")
    touch = {"first": "jaw", "second": "floor", "where": "start"}
    parts = parted(InCollision("it touches; guide it by hand", **touch, can_back_out=True))
    assert parts.advice == "guide it by hand; so101 move --leave-contact backs it out"
    assert parted(InCollision("it touches; guide it by hand", **touch)).advice == "guide it by hand"
    parts = parted(CalibrationError("elbow_flex", "too narrow", "calibrate again"))
    assert (parts.what, parts.advice) == ("elbow_flex: too narrow", "calibrate again")
    parts = parted(ConfigError("speed", 200.0, "must be between 3 and 180 deg/s"))
    assert (parts.what, parts.why, parts.advice) == (
        '"speed" = 200.0', "must be between 3 and 180 deg/s", "",
    )  # fmt: skip
