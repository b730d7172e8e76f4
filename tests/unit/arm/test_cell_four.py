"""Four arms in one cell, crowded: a share of ``benchmarks/bench_crowd.py``."""

import pytest

from benchmarks.bench_crowd import LAYOUTS, Crowd, by_themselves, follow_targets, together
from so101_motion.planning.collision.apart import GUARDED, ROOM


@pytest.fixture
def crowd(layout):
    with Crowd(LAYOUTS[layout], seed=11).opened() as crowd:
        yield crowd


@pytest.mark.parametrize("layout", LAYOUTS)
def test_four_arms_that_follow_targets_into_the_middle_keep_apart(crowd):
    ends = follow_targets(crowd, 150)
    assert crowd.touching == 0
    assert ends["held by another [arm ticks]"] > 150
    assert 0.5 * GUARDED < crowd.solids.nearest_hulls < 2.0 * GUARDED


@pytest.mark.parametrize("layout", ["ring"])
def test_four_arms_that_are_sent_together_arrive_together(crowd):
    assert together(crowd, 1) == {"arrived": 1}
    assert crowd.touching == 0
    assert crowd.solids.nearest_hulls > 0.8 * ROOM


@pytest.mark.parametrize("layout", ["square"])
def test_four_arms_that_are_sent_while_the_others_move_arrive_or_are_told_why_not(crowd):
    ends = by_themselves(crowd, 2)
    assert crowd.touching == 0
    assert ends["hangs"] == 0
    assert ends["arrived"] > 0
