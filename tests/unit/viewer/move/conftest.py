"""Fixtures of the tests of the Move tab's state."""

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
def arm():
    return FakeArm()


@pytest.fixture
def gripper():
    return FakeGripper()


@pytest.fixture
def inputs():
    return PageInputs()


@pytest.fixture
def page(arm, gripper, inputs):
    return ViewModel(
        arm=arm,
        gripper=gripper,
        load_solver=inputs.load_solver,
        submit=run_at_once,
        now=inputs.now,
        welcome=WELCOME,
    )
