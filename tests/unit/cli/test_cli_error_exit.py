"""Verbs that fail: a sentence on stderr for people, JSON on stdout for programs."""

from __future__ import annotations

import errno
import json
import logging
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result

from so101_motion.cli.error_exit import KINDS, reports_errors
from so101_motion.cli.shared import DEBUG, in_lines, print_json
from so101_motion.cli.verbs import main
from so101_motion.common.errors import ConfigError


@pytest.fixture(autouse=True)
def nothing_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    for name in ("SO101_PORT", "SO101_MACHINE", "SO101_API_KEY", "SO101_API_KEY_ID"):
        monkeypatch.delenv(name, raising=False)


def so101(*arguments: str, given: str = "") -> Result:
    return CliRunner().invoke(main, arguments, input=given)


def told(result: Result) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(result.stdout)
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
    arguments: str, code: int, error: str
) -> None:
    result = so101(*arguments.split(), "--json")
    assert result.exit_code == code, result.output
    content = told(result)
    assert content["error"] == error
    assert content["what"]
    assert content["what"] in result.stderr
    for part in ("why", "try"):
        assert content[part] in result.stderr or error == ""


def test_without_json_stdout_stays_empty() -> None:
    result = so101("plan", "--port", "/dev/no-such-port", "--pose", "ready")
    assert result.exit_code == 3
    assert result.stdout == ""


def test_a_refusal_to_agree_is_reported_as_json_too() -> None:
    result = so101("move", "--sim", "--joints", "5,0,0,0,0", "--json", given="n\n")
    assert told(result)["kind"] == "stopped"
    assert "nothing moved" in result.stderr


def test_a_verb_that_has_reported_its_error_is_not_reported_again() -> None:
    result = so101("ports", "--port", "/dev/no-such-port", "--json")
    assert result.exit_code == 3
    assert json.loads(result.stdout)["schema"] == "so101/ports/1"

    @click.command()
    @reports_errors(as_json=True)
    def fails_late() -> None:
        print_json("plan", {})
        raise ConfigError("out", "x", "cannot be written")

    late = CliRunner().invoke(fails_late)
    assert late.exit_code == 2
    assert json.loads(late.stdout)["schema"] == "so101/plan/1"
    assert "cannot be written" in late.stderr


def test_ctrl_c_and_a_defect_are_reported_as_json() -> None:
    @click.command()
    @click.argument("how")
    @reports_errors(as_json=True)
    def fails(how: str) -> None:
        # a codec that a signal ends gives it a message of its own
        raise KeyboardInterrupt("decoding failed") if how == "ctrl-c" else RuntimeError("oh")

    ended = told(CliRunner().invoke(fails, ["ctrl-c"]))
    assert (ended["kind"], ended["why"]) == ("interrupted", "nothing moved")
    defect = told(CliRunner().invoke(fails, ["defect"]))
    assert (defect["kind"], defect["error"]) == ("unexpected", "RuntimeError")


def test_the_documented_exit_codes_exist() -> None:
    page = (Path(__file__).parents[3] / "docs" / "command-line.md").read_text()
    for code, (kind, _) in KINDS.items():
        assert f"| {code} | `{kind}` |" in page


def test_a_log_line_is_one_line_and_shows_a_traceback_only_on_request(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def trouble() -> str:
        with in_lines():
            try:
                raise RuntimeError("oh")
            except RuntimeError:
                logging.getLogger("so101_motion.control.executor").exception("a servo is silent")
        return capsys.readouterr().err

    assert trouble() == "a servo is silent\n"
    monkeypatch.setenv(DEBUG, "1")
    assert "Traceback" in trouble()


def test_a_full_disk_is_no_defect_of_the_program(capsys):
    with pytest.raises(SystemExit), reports_errors():
        raise OSError(errno.ENOSPC, "No space left on device")
    told = capsys.readouterr().err
    assert "No space left" in told
    assert "defect" not in told
