"""Fixtures of the tests of the Move tab's state."""

from __future__ import annotations

import pytest
from harness.fake_page import (
    WELCOME,
    FakeArm,
    FakeGripper,
    PageInputs,
    run_at_once,
)
from so101_viewer.view_model import ViewModel


@pytest.fixture
def arm() -> FakeArm:
    return FakeArm()


@pytest.fixture
def gripper() -> FakeGripper:
    return FakeGripper()


@pytest.fixture
def inputs() -> PageInputs:
    return PageInputs()


@pytest.fixture
def page(arm: FakeArm, gripper: FakeGripper, inputs: PageInputs) -> ViewModel:
    return ViewModel(
        arm=arm,  # type: ignore[arg-type]
        gripper=gripper,  # type: ignore[arg-type]
        load_solver=inputs.load_solver,
        submit=run_at_once,
        now=inputs.now,
        welcome=WELCOME,
    )
