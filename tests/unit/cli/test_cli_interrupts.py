"""Signals at any instant end a verb with one code and one sentence that tells of the arm."""

import signal
import subprocess
import sys
import time

import pytest

MOVE = ("move", "--sim", "--pose", "ready", "--yes")
DEMO = ("demo", "--no-browser")
START = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler);"
LISTENS = "from so101_motion.cli import main; print(flush=True); main()"


@pytest.mark.parametrize("words", [MOVE, DEMO], ids=lambda words: words[0])
@pytest.mark.parametrize("after", [0.02, 0.4, 0.7, 1.0, 2.0])
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_ends_it_with_130_and_one_sentence(words, after, name, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    command = [sys.executable, "-c", START + LISTENS, *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as verb:
        verb.stdout.readline()
        time.sleep(after)
        for _ in range(3):  # the second and third must not cut short what ends the motion
            verb.send_signal(getattr(signal, name))
            time.sleep(0.06)
        _, said = verb.communicate(timeout=60.0)
    last = said.decode().splitlines()[-1]
    assert verb.returncode == 130, said
    assert last.startswith("ended by ")
    assert last.endswith(("; nothing moved", "; the simulated arm holds"))
    assert b"Traceback" not in said
