from dataclasses import replace

import numpy as np
import pytest
from harness.fake_page import STILL
from hypothesis import given
from hypothesis import strategies as st
from so101_viewer.page import texts
from so101_viewer.page.tracking import MotionTracker
from so101_viewer.panels.plots import nearest_limit


def state(t, q, q_ref, qd_ref, *, moving=True):
    reading = replace(STILL.reading, q=q)
    return replace(STILL, t=t, reading=reading, q_ref=q_ref, qd_ref=qd_ref, arm_moving=moving)


@given(lag=st.floats(0.0, 0.2), bias=st.floats(0.0, 0.01))
def test_an_arm_that_is_late_is_reported_by_how_much(lag, bias):
    tracker = MotionTracker()
    for t in np.linspace(5.0, 7.0, 41):
        q_ref, qd_ref = np.full(5, np.sin(np.pi * t)), np.full(5, np.pi * np.cos(np.pi * t))
        assert not tracker.take(state(t, q_ref - lag * qd_ref + bias, q_ref, qd_ref), "Plan 1")
    assert tracker.take(state(7.1, q_ref, q_ref, qd_ref, moving=False), "")
    tracking = tracker.newest
    assert tracker.newest_name == "Plan 1"
    assert tracking is not None
    assert tracking.lag == pytest.approx(lag, abs=0.01)
    assert tracking.t[0] == 0.0
    assert tracking.t[-1] == pytest.approx(2.0)
    np.testing.assert_allclose(tracking.worst, np.pi * lag, atol=bias + 1e-9)
    assert np.all(tracking.rms <= tracking.worst + 1e-12)


def test_only_new_snapshots_of_a_moving_arm_count():
    tracker = MotionTracker()
    still = np.zeros(5)

    def take(t, *, moving=True):
        return tracker.take(state(t, still, still, still, moving=moving), "")

    assert not take(1.0, moving=False)
    for _ in range(3):
        assert not take(2.0)
    assert take(2.1, moving=False)
    assert tracker.newest is None
    assert not take(3.0)
    assert not take(3.1)
    assert take(3.2, moving=False)
    tracking = tracker.newest
    assert tracking is not None
    assert len(tracking.t) == 2
    assert tracking.lag is None
    assert texts.followed(tracking) == "RMS 0.00°, largest 0.00° (shoulder_pan)"


def test_the_limit_a_motion_comes_nearest_to_is_the_one_that_is_drawn():
    bounds = (np.array([-2.0, -2.0, -1.0, -2.0, -2.0]), np.array([2.0, 1.5, 2.0, 2.0, 2.0]))
    assert nearest_limit(np.array([[0.0, 0.5, -0.7, 0.0, 0.0], [0.1] * 5]), bounds) == -1.0
    assert nearest_limit(np.array([[0.0, 1.4, -0.7, 0.0, 0.0]]), bounds) == 1.5
