"""Fixtures of the calibration's tests."""

import pytest
from harness.calibration_rig import LentArm


@pytest.fixture(autouse=True)
def own_home(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))


@pytest.fixture
def file(tmp_path):
    return tmp_path / "arm.json"


@pytest.fixture
def arm():
    """As new: no offsets, no limits."""
    return LentArm(calibrated=False)
