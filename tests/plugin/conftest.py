"""Fixtures of the plugin's tests."""

import numpy as np
import pytest
from harness.emulated_rig import MIDDLES_DEG
from harness.lerobot_bench import READY, lerobot_bench

FOLDED = (0.0, -1.6057, 1.3614, 1.0472, 0.0, 0.0)
"""An arm that nobody holds lies like this [rad]."""


@pytest.fixture
def bench(tmp_path):
    """An arm that stands at ``READY``, so that nothing has to be planned first."""
    start = np.radians(np.add(READY[:5], MIDDLES_DEG))
    with lerobot_bench(tmp_path, q_start=(*start, 0.5)) as bench:
        yield bench


@pytest.fixture
def folded(tmp_path):
    with lerobot_bench(tmp_path, q_start=FOLDED) as bench:
        yield bench
