"""An arm on a wire: the real rig and driver, the emulated servos, and one clock for all.

The pseudo-terminal is real and so are its microseconds; everything slower follows the clock, which
a test moves by hand. Replies come at once unless a test asks for lateness.
"""

import pytest
from harness.emulated_rig import hardware_bench


@pytest.fixture
def bench(tmp_path, planning_process):
    with hardware_bench(tmp_path) as bench:
        yield bench
