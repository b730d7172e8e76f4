"""Fixtures of the tests of the Move tab's state."""

from __future__ import annotations

import pytest
from harness.pretended_page import (
    WELCOME,
    PageInputs,
    PretendedArm,
    PretendedGripper,
    run_at_once,
)
from so101_viewer.view_model import ViewModel


@pytest.fixture
def arm() -> PretendedArm:
    return PretendedArm()


@pytest.fixture
def gripper() -> PretendedGripper:
    return PretendedGripper()


@pytest.fixture
def inputs() -> PageInputs:
    return PageInputs()


@pytest.fixture
def page(arm: PretendedArm, gripper: PretendedGripper, inputs: PageInputs) -> ViewModel:
    return ViewModel(
        arm=arm,  # type: ignore[arg-type]
        gripper=gripper,  # type: ignore[arg-type]
        load_solver=inputs.load_solver,
        submit=run_at_once,
        now=inputs.now,
        welcome=WELCOME,
    )
