"""The options that choose an arm."""

import click
import pytest
from click.testing import CliRunner
from harness.command_line import refused

from so101_motion.cli.options import verb
from so101_motion.cli.sources import ANY_SOURCE, Source
from so101_motion.cli.verbs import main
from so101_motion.cli.view import _opener
from so101_motion.common import errors


@verb()
def which(source=ANY_SOURCE):
    """Says what it was given."""
    click.echo(repr(source))


def ask(*arguments, **environment):
    return CliRunner().invoke(which, list(arguments), env=environment)


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
    assert says in refused(ask(*arguments, **environment))


def test_an_atlas_is_shown_without_an_arm(so101, tmp_path):
    assert "has no sweep" in refused(so101("view --no-browser --atlas", tmp_path))


def test_a_key_comes_from_the_environment_and_is_never_shown():
    result = ask("--machine", "m:1", SO101_API_KEY_ID="id", SO101_API_KEY="hunter2")
    assert "api_key_id='id'" in result.stdout
    assert "hunter2" not in result.output


def test_an_arm_on_the_page_is_left_as_asked(planning_process):
    opened = _opener(Source(port=None, at_end="home"), None)()
    assert opened.at_end == "home"
    opened.close()


def test_every_verb_has_its_place_in_the_help_and_help_of_its_own(so101):
    told = so101("--help").stdout
    for name, command in main.commands.items():
        assert f"\n  {name} " in told
        assert command.help
        result = so101(f"{name} --help")
        assert result.exit_code == 0
        assert "--help" in result.stdout
