"""A short share of the campaign; ``make campaign MINUTES=10`` does more of the same."""

import random

import pytest

from campaign import interleavings, sessions
from campaign.targets import attack

TARGETS = 300
SWUNG = 12
"""The seed with which joints swung into the floor when stops were planned harder."""


@pytest.fixture(scope="module")
def seed(request):
    """One of their own for every run; it is told with whatever fails."""
    return random.Random(request.config.option.hypothesis_seed).randrange(10**6)


@pytest.mark.parametrize("faulty", [False, True])
def test_requests_in_any_order_end_and_break_no_rule_of_motion(seed, faulty):
    done, _, broken = interleavings.run(seed, count=10, faulty=faulty)
    assert broken == []
    assert sum(done.values()) > 20


def test_a_session_with_a_module_that_is_stopped_and_continued_breaks_no_law(seed):
    told = sessions.run(seed, sessions=2, requests=12, stopped=(0.5,))
    assert told["failures"] == []
    assert told["each"]["process stopped"] == 1


@pytest.mark.parametrize(("fast", "fixed"), [(False, None), (True, SWUNG)])
def test_an_arm_that_follows_touches_nothing_whatever_it_is_sent(fast, fixed, seed, tmp_path):
    seed = fixed or seed
    outcome = attack(tmp_path, seed=seed, count=TARGETS, fast=fast)
    assert (outcome.contacts, outcome.broken) == ([], []), f"seed {seed}"
    assert outcome.refused > 0 or outcome.travelled > 0.0
