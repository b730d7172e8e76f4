"""Fixtures of the module's tests."""

from pathlib import Path

import pytest
from harness.in_process_module import arm_client, new_arm
from harness.viam_machine import running_machine

from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.viam.models.simulated import SimulatedArm
from so101_motion.viam.models.simulated_gripper import SimulatedGripper

LONGEST = 400.0
"""How long a test may take where it does not say so itself [s]: processes start slowly on a busy
machine."""


def pytest_collection_modifyitems(items):
    for item in items:
        is_ours = item.path.is_relative_to(Path(__file__).parent)
        if is_ours and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(LONGEST))


@pytest.fixture(scope="session", autouse=True)
def planning_process():
    """Keep the planning process between tests; starting it for each would cost a second."""
    with open_simulated():
        yield


@pytest.fixture(scope="session")
def machine():
    """A machine with a simulated arm and gripper, for all tests that leave its components alone."""
    with running_machine() as machine:
        yield machine


@pytest.fixture(scope="session", autouse=True)
def module_data(tmp_path_factory):
    """What modules in this process keep, recordings and paths, is not left where the tests run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VIAM_MODULE_DATA", str(tmp_path_factory.mktemp("module-data")))
        yield


@pytest.fixture(autouse=True)
def every_test_begins_with_new_arms():
    """A simulated arm stands where the last one of its name was left."""
    SimulatedArm.left_at.clear()
    SimulatedGripper.left_at.clear()


@pytest.fixture
async def arm(request):
    """An arm whose time moves only when told to, with the ``ATTRIBUTES`` of the test's module."""
    arm = new_arm(simulate_time=False, **getattr(request.module, "ATTRIBUTES", {}))
    yield arm
    await arm.close()


@pytest.fixture
async def client(arm):
    async with arm_client(arm) as client:
        yield client
