from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from so101_viewer.page import texts
from so101_viewer.page.tracking import Tracker
from so101_viewer.panels.plots import nearest_limit

from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.state import JointReading, JointState


def state(t: float, q: Array, q_ref: Array, qd_ref: Array, *, moving: bool = True) -> JointState:
    return JointState(
        t=t,
        mode=Mode.MOVING,
        reading=JointReading(q=q, qd=np.zeros(5), q_jaw=0.0, qd_jaw=0.0),
        q_ref=q_ref,
        qd_ref=qd_ref,
        q_jaw_ref=0.0,
        arm_moving=moving,
        jaw_moving=False,
        late_ticks=0,
    )


@given(lag=st.floats(0.0, 0.2), bias=st.floats(0.0, 0.01))
def test_an_arm_that_is_late_is_reported_by_how_much(lag: float, bias: float) -> None:
    tracker = Tracker()
    for t in np.linspace(5.0, 7.0, 41):
        q_ref, qd_ref = np.full(5, np.sin(np.pi * t)), np.full(5, np.pi * np.cos(np.pi * t))
        tracker.take(state(t, q_ref - lag * qd_ref + bias, q_ref, qd_ref))
    tracking = tracker.tracking()
    assert tracking is not None
    assert tracking.lag == pytest.approx(lag, abs=0.01)
    assert tracking.t[0] == 0.0
    assert tracking.t[-1] == pytest.approx(2.0)
    np.testing.assert_allclose(tracking.worst, np.pi * lag, atol=bias + 1e-9)
    assert np.all(tracking.rms <= tracking.worst + 1e-12)


def test_only_new_snapshots_of_a_moving_arm_count() -> None:
    tracker = Tracker()
    still = np.zeros(5)
    tracker.take(state(1.0, still, still, still, moving=False))
    assert tracker.tracking() is None
    for _ in range(3):
        tracker.take(state(2.0, still, still, still))
    assert tracker.tracking() is None
    tracker.take(state(2.1, still, still, still))
    tracking = tracker.tracking()
    assert tracking is not None
    assert len(tracking.t) == 2
    assert tracking.lag is None
    assert texts.followed(tracking) == "RMS 0.00°, largest 0.00° (shoulder_pan)"


def test_the_limit_a_motion_comes_nearest_to_is_the_one_that_is_drawn() -> None:
    bounds = (np.array([-2.0, -2.0, -1.0, -2.0, -2.0]), np.array([2.0, 1.5, 2.0, 2.0, 2.0]))
    assert nearest_limit(np.array([[0.0, 0.5, -0.7, 0.0, 0.0], [0.1] * 5]), bounds) == -1.0
    assert nearest_limit(np.array([[0.0, 1.4, -0.7, 0.0, 0.0]]), bounds) == 1.5
