"""The values that Tab offers in a shell."""

import os
import shutil
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from serial.tools import list_ports

from so101_motion.cli.verbs import main
from so101_motion.files.saved_poses import SavedPoses
from so101_motion.tasks.program import Program, Waypoint, files


def offered(*words):
    """What is offered for the last of these words, each with its kind."""
    asked = {
        "_SO101_COMPLETE": "bash_complete",
        "COMP_WORDS": "\n".join(("so101", *words)),
        "COMP_CWORD": str(len(words)),
    }
    told = CliRunner().invoke(main, [], prog_name="so101", env=asked)
    return [line for line in told.output.splitlines() if line]


def test_verbs_poses_and_programs_are_offered_ones_own_too_and_files_where_none_fits():
    assert {"plain,calibrate", "plain,calibration"} <= set(offered("calib"))
    assert offered("plan", "--pose", "") == ["plain,home", "plain,ready", "plain,rest"]
    SavedPoses().save("over the mug", np.zeros(5))
    assert offered("move", "--sim", "--pose", "o") == ["plain,over the mug"]
    made = Program.of_waypoints([Waypoint(name="a", q=np.zeros(5))])
    files.write(made, files.file_of("stack it"))
    assert offered("run", "") == ["plain,stack it"]
    assert offered("run", "wave") == ["file,wave"]


def test_a_pose_file_that_cannot_be_read_is_no_reason_to_complain(data):
    data.mkdir(parents=True)
    (data / "poses.json").write_text("{")
    assert offered("plan", "--pose", "r") == ["plain,ready", "plain,rest"]


@pytest.mark.parametrize(
    "words", [("status", "--port"), ("ports", "--port"), ("teleop", "--leader")], ids=str
)
def test_ports_are_offered_by_each_of_their_names(words, monkeypatch):
    names = ("/dev/cu.usbmodem58CD", "/dev/tty.usbmodem58CD")  # as macOS shows one adapter
    told = {"vid": 0x1A86, "pid": 0x55D3, "serial_number": "58CD", "location": "1-1", "product": ""}
    listed = [SimpleNamespace(device=name, **told) for name in names]
    monkeypatch.setattr(list_ports, "comports", lambda: listed)
    assert offered(*words, "") == [f"plain,{name}" for name in names]
    assert offered(*words, "/dev/tty") == [f"plain,{names[1]}"]
    assert offered(*words, "/tmp/so") == ["file,/tmp/so"]


def test_nothing_heavy_is_imported_for_it():
    asked = {"_SO101_COMPLETE": "bash_complete", "COMP_WORDS": "so101\nplan\n--pose\n"}
    program = (
        "import sys, atexit\n"
        "heavy = {'pinocchio', 'coal', 'scipy', 'viser', 'viam', 'toppra', 'ruckig', 'rich'}\n"
        "atexit.register(lambda: print(sorted(heavy & set(sys.modules))))\n"
        "from so101_motion.cli import main; main()"
    )
    environment = {**os.environ, **asked, "COMP_CWORD": "3"}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == ["plain,home", "plain,ready", "plain,rest", "[]"]


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash here")
@pytest.mark.parametrize(
    ("typed", "made"),
    [("ov", r"over\ the\ mug"), ('"ov', "over the mug"), ("it", r"it\'s\ \$HOME")],
)
def test_bash_itself_completes_names_with_blanks(typed, made, tmp_path):
    """With a program in place of so101 that answers as it would."""
    script = CliRunner().invoke(main, ["completion", "bash"]).stdout
    so101 = tmp_path / "so101"
    quoted = made.replace("\\", "").replace("'", "'\\''")
    so101.write_text(f"#!/bin/sh\necho 'plain,{quoted}'\n")
    so101.chmod(0o755)
    run = (
        f"{script}\nCOMP_WORDS=(so101 plan --pose {typed!r}); COMP_CWORD=3\n"
        '_so101_completion so101\nprintf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "--norc", "-c", run], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == made


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_gets_a_script_that_completes(shell):
    result = CliRunner().invoke(main, ["completion", shell])
    assert result.exit_code == 0, result.output
    assert "_SO101_COMPLETE" in result.stdout
