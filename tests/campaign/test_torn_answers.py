"""A short share of ``torn_answers.py`` and ``good_answers.py``: answers on the bus."""

import logging

import pytest

from campaign import good_answers
from campaign.torn_answers import run


@pytest.fixture(autouse=True)
def faults_are_expected(caplog):
    caplog.set_level(logging.CRITICAL, logger="so101_motion.control.joint_controller")


def test_wrong_answers_make_nothing_jump_and_nothing_impossible_is_believed():
    counter = run(spoiled=1000, seed=16)
    assert counter.broken == []
    assert counter.total >= 1000


def test_right_answers_of_roughly_handled_joints_are_not_doubted():
    answers, doubted, fastest = good_answers.run(2000, seed=1)
    assert answers >= 2000
    assert fastest > 100.0
    assert doubted == 0
