"""``so101 move-test`` up to the question whether the arm may move."""

import signal
import subprocess
import sys

import pytest
from click.testing import CliRunner

from so101_motion.cli.shared import write_report
from so101_motion.cli.verbs import main
from so101_motion.common.errors import ConfigError
from so101_motion.setup.move_test import MoveReport


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    return lambda *arguments, **how: CliRunner().invoke(main, ["move-test", *arguments], **how)


def test_nothing_moves_before_somebody_agrees(run):
    result = run("--sim", input="n\n")
    assert result.exit_code == 7
    assert "6° back and forth" in result.output
    assert "Is everything out of the way?" in result.output
    assert "nothing moved" in result.output
    assert "0 %  shoulder_pan" not in result.output


def test_ctrl_c_stops_the_arm_and_what_was_measured_is_reported(tmp_path):
    program = "from so101_motion.cli import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", program, "move-test", "--sim", "--yes"],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while "0 %" not in process.stderr.readline():
        pass
    process.send_signal(signal.SIGINT)
    told, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "not tested" in told
    assert said == "ended by Ctrl-C; the simulated arm holds\n"


def test_its_help_says_that_the_arm_moves(run):
    assert "The arm MOVES" in " ".join(run("--help").output.split())


def test_which_arm_must_be_said(run):
    assert run(env={"SO101_PORT": ""}).exit_code == 2


def test_a_report_that_cannot_be_written_is_said(tmp_path):
    report = MoveReport(arm="a", joints=(), began_at="2026-01-02T03:04:05+00:00", seconds=1.0)
    with pytest.raises(ConfigError, match="cannot be written"):
        write_report(tmp_path / "no" / "folder.json", report.file({}))
    write_report(tmp_path / "r.json", report.file({}))
    assert "so101/move-test/1" in (tmp_path / "r.json").read_text()
