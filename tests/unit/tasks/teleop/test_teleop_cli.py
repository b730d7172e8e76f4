import csv
import json
from types import SimpleNamespace

import pytest
from harness.command_line import refused

from so101_motion.cli.teleop import print_end
from so101_motion.common.modes import Mode

SIMULATED = "teleop --leader sim --follower sim"


def test_two_simulated_arms_show_how_it_goes(so101, tmp_path):
    record = tmp_path / "session.csv"
    how = "--yes --seconds 0.6 --json --fps 50 --guard --mirror --scale 0.5 --record"
    result = so101(f"{SIMULATED} {how}", record)
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["schema"] == "so101/teleop/1"
    assert told["ended_as"] == "mirroring"
    assert told["last_error"] == ""
    rows = list(csv.DictReader(record.read_text().splitlines()))
    assert len(rows) >= 22, "0.6 s, and what a busy machine takes to end it"
    assert "Following the leader." in result.stderr
    assert result.stderr.endswith("ended: both arms hold\n")


def test_without_a_hand_on_the_leader_it_stays_held(so101):
    assert "limp" in refused(so101(SIMULATED, input="n\n"), 7)


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
