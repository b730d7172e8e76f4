"""Pairs of simulated arms in one cell."""

from contextlib import ExitStack

import pytest
from harness.facing_arms import Pair


@pytest.fixture
def stack():
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def pair_of(clock, stack):
    return lambda facing, *starts: Pair(clock, facing, *starts, stack)
