"""A short share of the campaign; ``make campaign MINUTES=10`` does more of the same."""

import random

import pytest

from campaign import interleavings, sessions
from campaign.mutator import attack
from campaign.readers import OURS, all_readers
from campaign.targets import attack as attack_with_targets

EXECUTIONS = 150
TARGETS = 300
SWUNG = 12
"""The seed with which joints swung into the floor when stops were planned harder."""


@pytest.fixture(scope="module")
def seed(request):
    """One of their own for every run; it is told with whatever fails."""
    return random.Random(request.config.option.hypothesis_seed).randrange(10**6)


@pytest.mark.parametrize("name", [reader.name for reader in all_readers()])
def test_a_reader_refuses_what_it_cannot_read_with_an_error_of_ours(name, seed, tmp_path):
    (reader,) = (each for each in all_readers(tmp_path) if each.name == name)
    outcome = attack(reader, OURS, seed=seed, executions=EXECUTIONS)
    assert outcome.failures == {}, f"seed {seed}"
    assert outcome.executions == EXECUTIONS
    assert outcome.lines > 10


@pytest.mark.parametrize("name", [reader.name for reader in all_readers()])
def test_the_campaigns_first_inputs_are_valid(name, tmp_path):
    (reader,) = (each for each in all_readers(tmp_path) if each.name == name)
    if name in ("attributes", "faults and hands"):
        pytest.skip("each input is for one of several readers")
    for data in reader.seeds:
        reader.read(data)


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
    outcome = attack_with_targets(tmp_path, seed=seed, count=TARGETS, fast=fast)
    assert (outcome.contacts, outcome.broken) == ([], []), f"seed {seed}"
    assert outcome.refused > 0 or outcome.travelled > 0.0
