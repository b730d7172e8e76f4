import subprocess
import sys

import pytest
from click.testing import CliRunner

from so101_motion.cli import main


@pytest.fixture
def run():
    return CliRunner().invoke


@pytest.mark.slow
def test_the_demo_in_text_shows_a_plan_and_arrives(run):
    result = run(main, ["demo", "--text"])
    assert result.exit_code == 0, result.output
    for word in ("shoulder_pan", "wrist_roll", "deg/s", "setpoints", "arrived", "simulated"):
        assert word in result.output


def test_a_busy_port_is_named_with_something_to_try(run):
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        result = run(main, ["demo", "--web-port", str(port)])
    assert result.exit_code == 3
    assert f"127.0.0.1:{port}" in result.output
    assert "choose another port" in result.output


def test_wrong_usage_is_exit_code_2(run):
    assert run(main, ["demo", "--no-such-option"]).exit_code == 2


@pytest.mark.parametrize(
    ("option", "says"),
    [(["--ids", "9"], "places 1 to 6"), (["--fault", "nonsense"], "must be one of dead")],
)
def test_an_emulation_that_cannot_be_is_refused_in_a_sentence(run, option, says):
    result = run(main, ["emulate", *option])
    assert result.exit_code == 3
    assert says in result.output


def test_the_emulator_prints_its_port_and_ends_on_sigterm(tmp_path):
    link = tmp_path / "arm"
    command = [sys.executable, "-m", "so101_motion.cli", "emulate", "--link", str(link)]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as emulator:
        assert emulator.stdout.readline().decode().strip() == str(link)
        assert link.is_symlink()
        emulator.terminate()
        assert emulator.wait(10.0) == 0
    assert not link.exists()
