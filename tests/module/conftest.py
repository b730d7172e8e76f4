"""What the tests of the module share."""

import pytest

from so101_motion.rig import open_simulated


@pytest.fixture(scope="session", autouse=True)
def planning_process():
    """Keep the planning process between tests; starting it for each would cost a second."""
    with open_simulated():
        yield
