"""A short share of the campaign; ``make campaign EXAMPLES=50`` tries as many seeds of each."""

import logging
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from campaign import interleavings, sessions, signals, spoilt_arms, targets, torn_answers, verdicts
from so101_motion.planning.kinematics.model import RobotModel

SWUNG = 12
"""The seed with which joints swung into the floor when stops were planned harder."""


def with_seeds(test):
    """One seed of its own for every run; it is told with whatever fails."""
    drawn = given(seed=st.integers(0, 10**6))(test)
    return pytest.mark.campaign(settings(max_examples=1, phases=[Phase.generate])(drawn))


@with_seeds
@pytest.mark.parametrize("faulty", [False, True])
def test_requests_in_any_order_end_and_break_no_rule_of_motion(faulty, seed):
    done, broken = interleavings.run(seed, count=10, faulty=faulty)
    assert broken == []
    assert done.total() > 20


@with_seeds
def test_a_session_with_a_module_that_is_stopped_and_continued_breaks_no_law(seed):
    assert sessions.run(seed, sessions=2, requests=12) == []


@with_seeds
def test_an_arm_that_follows_touches_nothing_whatever_it_is_sent(seed):
    follow_targets(seed, fast=seed % 2 == 1)


def test_an_arm_that_follows_does_not_swing_into_the_floor_when_it_stops():
    follow_targets(SWUNG, fast=True)


def follow_targets(seed, fast):
    with tempfile.TemporaryDirectory() as folder:
        outcome = targets.attack(Path(folder), seed=seed, count=300, fast=fast)
    assert (outcome.contacts, outcome.broken) == ([], [])
    assert outcome.refused > 0 or outcome.travelled > 0.0


@with_seeds
def test_the_compiled_verdicts_are_coals(seed):
    assert verdicts.compare(np.random.default_rng(seed), RobotModel.load(), 400) == []


@with_seeds
def test_the_doctor_is_right_about_spoilt_arms(seed):
    assert spoilt_arms.run(seed, count=2) == []


# Answers on the bus


@pytest.fixture
def quiet(caplog):
    """Faults are expected."""
    caplog.set_level(logging.CRITICAL, logger="so101_motion.control.joint_controller")


@pytest.mark.usefixtures("quiet")
@with_seeds
def test_wrong_answers_make_nothing_jump_and_nothing_impossible_is_believed(seed):
    counter = torn_answers.run(spoiled=1000, seed=seed)
    assert counter.broken == []
    assert counter.spoiled.total() >= 1000


# Signals to verbs


@with_seeds
@pytest.mark.timeout(660)
def test_a_signal_at_any_instant_ends_a_verb_with_130_and_one_true_sentence(seed):
    assert signals.run(seed, count=6) == []


def test_a_verb_that_nohup_has_started_outlives_its_terminal():
    command = ["nohup", sys.executable, "-c", signals.LISTENS, "demo", "--no-browser"]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **pipes) as verb:
        verb.stdout.readline()
        verb.send_signal(signal.SIGHUP)
        assert b"open" in verb.stdout.readline()
        verb.send_signal(signal.SIGTERM)
        assert verb.communicate(timeout=60.0)[1].splitlines()[-1].startswith(b"ended by SIGTERM")
    assert verb.returncode == 130


def test_a_signal_in_a_long_import_ends_a_verb_that_has_nothing_open(tmp_path):
    (tmp_path / "slow.py").write_text(
        "import signal, time\n"
        "signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])\n"  # it interrupts no wait
        "print(flush=True)\ntime.sleep(600.0)\n"
    )
    code = (
        "from so101_motion import cli\ncli.interrupts.listen(cli._end_by_force, cli._end_in_import)"
    )
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "cwd": tmp_path}
    command = [sys.executable, "-c", f"{signals.HEARS}{code}\nimport slow"]
    with subprocess.Popen(command, **pipes) as verb:
        verb.stdout.readline()
        verb.send_signal(signal.SIGINT)
        assert verb.communicate(timeout=60.0)[1] == b"ended by Ctrl-C; nothing moved\n"
    assert verb.returncode == 130
