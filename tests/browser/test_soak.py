"""The soak of the page, short: its bars that a busy computer cannot spoil."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from benchmarks.soak_page import soak_for

pytestmark = [pytest.mark.browser, pytest.mark.slow]


def test_two_windows_that_come_go_and_move_the_arm_leave_nothing_behind() -> None:
    soak = soak_for(15.0, windows=2)
    assert soak.moves >= 1
    assert soak.problems == []
    assert soak.idle_cpu < 0.05
    assert max(soak.threads) <= min(soak.threads) + 2
