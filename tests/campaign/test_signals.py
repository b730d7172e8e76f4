"""A quarter of the verbs get a signal; ``make campaign`` sends more, 200 to each with FULL=1."""

import random
import signal
import subprocess
import sys

import pytest

from campaign.signals import HEARS, LISTENS, VERBS, run


@pytest.mark.timeout(660)
def test_a_signal_at_any_instant_ends_a_verb_with_130_and_one_true_sentence(request):
    seed = random.Random(request.config.option.hypothesis_seed).randrange(10**6)
    told = run(seed, seconds=600.0, count=len(VERBS) // 4)
    assert told["failures"] == []
    assert told["signals"] == len(VERBS) // 4


def test_a_verb_that_nohup_has_started_outlives_its_terminal():
    command = ["nohup", sys.executable, "-c", LISTENS, "demo", "--no-browser"]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **pipes) as verb:
        verb.stdout.readline()
        verb.send_signal(signal.SIGHUP)
        assert b"open" in verb.stdout.readline()
        verb.send_signal(signal.SIGTERM)
        assert verb.communicate(timeout=60.0)[1].splitlines()[-1].startswith(b"ended by SIGTERM")
    assert verb.returncode == 130


def test_a_signal_in_a_long_import_ends_a_verb_that_has_nothing_open(tmp_path):
    (tmp_path / "slow.py").write_text("import time\nprint(flush=True)\ntime.sleep(600.0)\n")
    code = (
        "from so101_motion import cli\ncli.interrupts.listen(cli._end_by_force, cli._end_in_import)"
    )
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "cwd": tmp_path}
    with subprocess.Popen([sys.executable, "-c", f"{HEARS}{code}\nimport slow"], **pipes) as verb:
        verb.stdout.readline()
        verb.send_signal(signal.SIGINT)
        assert verb.communicate(timeout=60.0)[1] == b"ended by Ctrl-C; nothing moved\n"
    assert verb.returncode == 130
