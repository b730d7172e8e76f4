"""``so101 guide`` on the simulated arm."""

import json
import signal
import subprocess
import sys

import numpy as np
import pytest
from harness.command_line import refused

from so101_motion.tasks.guided import GuidedPath, files

WAVE = GuidedPath(
    t=[0.0, 0.5, 1.0],
    q=np.radians([[0, -10, 10, 0, 0], [8, -10, 10, 0, 0], [8, -14, 10, 5, 0]]),
    aperture=[0.0, 0.0, 0.2],
)


@pytest.fixture
def run(so101):
    return lambda line, *words, **how: so101(f"guide {line}", *words, **how)


@pytest.fixture
def file(tmp_path):
    files.write(WAVE, tmp_path / "wave.json")
    return tmp_path / "wave.json"


def test_a_path_is_replayed_and_reported(run, file):
    result = run("replay --sim --speed 150 --acceleration 400 --times 2 --yes --json", file)
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["schema"] == "so101/guide-replay/1"
    assert told["points"] == 3
    assert told["times"] == 2
    assert told["off_deg"] < 0.1


def test_it_says_what_it_will_do_and_asks_first(run, file):
    result = run("replay --sim", file, input="n\n")
    assert result.exit_code == 7
    assert "to its start" in result.output
    assert "Move the simulated arm?" in result.output


def test_what_is_recorded_is_saved_and_not_lost_by_accident(run, tmp_path):
    file = tmp_path / "still.json"
    result = run("record --sim --seconds 0.3 --yes --json", file)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["has_jaw"]
    assert files.read(file).duration >= 0.2
    assert "there already" in refused(run("record --sim --yes", file))


def test_ctrl_c_loses_nothing(tmp_path):
    program = "import sys; from so101_motion.cli import main; main()"
    file = tmp_path / "wave.json"
    process = subprocess.Popen(
        [sys.executable, "-c", program, "guide", "record", "--sim", str(file), "--yes"],
        stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert "move the arm by hand" in process.stderr.readline()
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "saved" in said
    assert len(files.read(file)) >= 1
