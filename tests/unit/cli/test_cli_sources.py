"""The options that choose an arm, how errors are reported, and completion."""

import errno

import click
import pytest
from click.testing import CliRunner

from so101_motion.cli.error_exit import parted, reports_errors
from so101_motion.cli.options import verb
from so101_motion.cli.shared import DEBUG
from so101_motion.cli.sources import ANY_SOURCE, MachineSource, Source, with_caps
from so101_motion.cli.verbs import main
from so101_motion.common import errors


@verb()
def which(source=ANY_SOURCE):
    """Says what it was given."""
    click.echo(repr(source))


def ask(*arguments, **environment):
    none = dict.fromkeys(("SO101_PORT", "SO101_MACHINE", "SO101_API_KEY", "SO101_API_KEY_ID"))
    return CliRunner().invoke(which, list(arguments), env={**none, **environment})


def test_what_is_typed_wins_over_the_environment():
    assert "port='/dev/a'" in ask("--port", "/dev/a", SO101_MACHINE="m:1").stdout
    assert "address='m:1'" in ask("--machine", "m:1", SO101_PORT="/dev/a").stdout
    assert "port=None" in ask("--sim", SO101_PORT="/dev/a", SO101_MACHINE="m:1").stdout
    assert "port='/dev/a'" in ask(SO101_PORT="/dev/a").stdout
    assert "address='m:1'" in ask(SO101_MACHINE="m:1").stdout


def test_a_calibration_that_was_named_and_cannot_be_used_moves_nothing(tmp_path):
    there = tmp_path / "arm.json"
    there.write_text("{")
    for file, says in ((tmp_path / "none.json", "No such file"), (there, "arm.json")):
        with pytest.raises(errors.CalibrationError, match=says):
            Source(port="/dev/none", calibration_file=file).open()


@pytest.mark.parametrize(
    ("arguments", "environment", "says"),
    [
        ((), {}, "which arm?"),
        (("--sim", "--port", "/dev/a"), {}, "not both"),
        (("--port", "/dev/a", "--machine", "m"), {}, "not both"),
        ((), {"SO101_PORT": "/dev/a", "SO101_MACHINE": "m"}, "not both"),
        (("--sim", "--arm", "left"), {}, "work only with --machine"),
    ],
)
def test_a_source_that_is_not_clear_is_asked_for(arguments, environment, says):
    result = ask(*arguments, **environment)
    assert result.exit_code == 2
    assert says in result.stderr


def test_an_atlas_is_shown_without_an_arm(tmp_path):
    asked = ["view", "--no-browser", "--atlas", str(tmp_path)]
    result = CliRunner().invoke(main, asked, env={"SO101_PORT": None, "SO101_MACHINE": None})
    assert result.exit_code == 2
    assert "has no sweep" in result.stderr


def test_a_key_comes_from_the_environment_and_is_never_shown():
    result = ask("--machine", "m:1", SO101_API_KEY_ID="id", SO101_API_KEY="hunter2")
    assert "api_key_id='id'" in result.stdout
    assert "hunter2" not in result.output


def test_caps_are_the_same_for_every_source():
    for source in (Source(port=None), MachineSource(address="m")):
        assert with_caps(source, 90.0, None).speed == pytest.approx(1.5707963)
        assert with_caps(source, None, None).speed is None


# Errors


def test_an_error_is_printed_as_what_why_and_what_to_try():
    told = parted(errors.PortUnavailable("/dev/a", "in use by another program; end it first"))
    assert (told.what, told.why, told.advice) == (
        "/dev/a", "in use by another program", "end it first",
    )  # fmt: skip
    told = parted(errors.CalibrationError("elbow_flex", "too narrow", "calibrate again"))
    assert (told.what, told.advice) == ("elbow_flex: too narrow", "calibrate again")
    told = parted(errors.ConfigError("speed", 200.0, "must be between 3 and 180 deg/s"))
    assert (told.what, told.why, told.advice) == (
        '"speed" = 200.0', "must be between 3 and 180 deg/s", "",
    )  # fmt: skip


def test_a_reader_who_closes_the_pipe_is_no_defect():
    @click.command()
    @reports_errors()
    def tells():
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    result = CliRunner().invoke(tells)
    assert result.exit_code == 1
    assert result.output == ""


def test_a_defect_is_reported_without_a_traceback_unless_asked_for(monkeypatch):
    @click.command()
    @reports_errors()
    def fails():
        raise RuntimeError("oh")

    result = CliRunner().invoke(fails)
    assert result.exit_code == 1
    assert "unexpected: RuntimeError: oh" in result.stderr
    assert "Traceback" not in result.output
    monkeypatch.setenv(DEBUG, "1")
    assert isinstance(CliRunner().invoke(fails).exception, RuntimeError)


# Shells and help


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_gets_a_script_that_completes(shell):
    result = CliRunner().invoke(main, ["completion", shell])
    assert result.exit_code == 0, result.output
    assert "_SO101_COMPLETE" in result.stdout


def test_verbs_and_options_are_completed():
    asked = {"_SO101_COMPLETE": "bash_complete", "COMP_WORDS": "so101 calib", "COMP_CWORD": "1"}
    told = CliRunner().invoke(main, [], prog_name="so101", env=asked).output
    assert {"plain,calibrate", "plain,calibration"} <= set(told.split())


def test_every_verb_has_its_place_in_the_help_and_help_of_its_own():
    told = CliRunner().invoke(main, ["--help"]).stdout
    for name, command in main.commands.items():
        assert f"\n  {name} " in told
        assert command.help
        result = CliRunner().invoke(main, [name, "--help"])
        assert result.exit_code == 0
        assert "--help" in result.stdout
