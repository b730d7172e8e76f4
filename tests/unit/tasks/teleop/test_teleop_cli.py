import csv
import json
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from so101_motion.cli.teleop import print_end
from so101_motion.cli.verbs import main
from so101_motion.common.modes import Mode


def run(*arguments, **options):
    return CliRunner().invoke(main, ["teleop", *map(str, arguments)], **options)


def test_two_simulated_arms_show_how_it_goes(tmp_path):
    record = tmp_path / "session.csv"
    result = run(
        "--leader", "sim", "--follower", "sim", "--yes", "--seconds", "0.6", "--json",
        "--record", record, "--fps", "50", "--guard", "--mirror", "--scale", "0.5",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["schema"] == "so101/teleop/1"
    assert told["ended_as"] == "mirroring"
    assert told["last_error"] == ""
    rows = list(csv.DictReader(record.read_text().splitlines()))
    assert 22 <= len(rows) < 150, "0.6 s, and what a busy machine takes to end it"
    assert "mirroring" in result.stderr
    assert result.stderr.endswith("ended: both arms hold\n")


def test_without_a_hand_on_the_leader_it_stays_held():
    result = run("--leader", "sim", "--follower", "sim", input="n\n")
    assert result.exit_code == 7
    assert "limp" in result.output


@pytest.mark.parametrize(
    ("leader", "follower", "says"),
    [
        (Mode.HOLDING, Mode.STOPPING, "both arms hold"),
        (Mode.LIMP, Mode.HOLDING, "the leader is not held"),
        (Mode.LIMP, Mode.FAULT, "the leader is not held; the follower is in a fault"),
    ],
)
def test_an_end_by_ctrl_c_says_who_holds(leader, follower, says, capsys):
    print_end(SimpleNamespace(is_running=True, reason=""), leader, follower)
    assert capsys.readouterr().err == f"ended: {says}\n"


def test_an_unrequested_end_is_printed_and_is_no_success(capsys):
    stopped = SimpleNamespace(is_running=False, reason="the follower was stopped")
    with pytest.raises(SystemExit) as ended:
        print_end(stopped, Mode.HOLDING, Mode.HOLDING)
    assert ended.value.code == 7
    assert capsys.readouterr().err == "ended: the follower was stopped\n"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--leader", "/dev/ttyACM0"), "--follower"),
        (("--leader", "/dev/x", "--follower", "/dev/x", "--yes"), "two arms"),
        (("--leader", "sim", "--follower", "sim", "--scale", "1,2"), "5 of them"),
        (("--leader", "sim", "--follower", "sim", "--scale", "big"), "neither a number"),
        (("--leader", "sim", "--follower", "sim", "--speed", "999"), "180"),
        (("--leader", "sim", "--follower", "sim", "--yes", "--record", "a.xlsx"), ".csv or .mcap"),
    ],
)
def test_invalid_input_is_refused_with_a_sentence(arguments, says):
    result = run(*arguments)
    assert result.exit_code == 2
    assert says in result.output


def test_a_port_that_is_not_there_is_reported(tmp_path):
    result = run("--leader", tmp_path / "no-port", "--follower", "sim", "--yes")
    assert result.exit_code == 3
    assert "no such port" in result.output
