"""The arms that the contract is tried on."""

from contextlib import closing

import pytest
from harness.contract_benches import Emulated, Real, Simulated


@pytest.fixture
def on_servos(arm_port, tmp_path, planning_process):
    with closing(Real(arm_port) if arm_port else Emulated(tmp_path)) as bench:
        yield bench


@pytest.fixture(params=["simulated", "on_servos"])
def bench(request, arm_port, planning_process):
    if request.param == "on_servos":
        yield request.getfixturevalue("on_servos")
        return
    if arm_port:
        pytest.skip("only the arm on the port is tried")
    with closing(Simulated()) as bench:
        yield bench


@pytest.fixture
def rig(bench):
    return bench.rig
