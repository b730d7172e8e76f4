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
