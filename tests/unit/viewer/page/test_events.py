from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from harness.fake_page import STILL
from hypothesis import given
from hypothesis import strategies as st
from so101_viewer.page.events import KEPT, EventLog
from so101_viewer.page.tracking import MotionTracker
from so101_viewer.panels.events_panel import ArmEvents
from so101_viewer.panels.plots import nearest_limit

from so101_motion.common.modes import Mode
from so101_motion.rig.protocols import ArmConnection


class Seen:
    """A witness of an arm that a test makes up."""

    def __init__(self):
        tool = SimpleNamespace(p=np.array([0.25, -0.12, 0.15]))
        self.arm = SimpleNamespace(state=STILL, newest=None, T_base=lambda _frame: tool)
        self.rig = SimpleNamespace(arm=self.arm, connection=ArmConnection(to="arm on X"))
        self.told = []
        self.witness = ArmEvents(self.rig, lambda *words: self.told.append(words))

    def after(self, **changes):
        """What is told when the state changes like that."""
        self.told.clear()
        self.arm.state = replace(self.arm.state, **changes)
        self.witness.refresh()
        return [text for text, _ in self.told]


@pytest.fixture
def seen():
    return Seen()


def test_a_motion_is_reported_at_its_begin_and_at_its_end_with_the_place_and_the_time(seen):
    assert seen.after(mode=Mode.MOVING, arm_moving=True, t=11.0) == ["The arm moves"]
    told = seen.after(mode=Mode.HOLDING, arm_moving=False, t=13.5)
    assert told == ["Arrived with the jaw tip at (250, -120, 150) mm in 2.5 s"]
    seen.after(mode=Mode.MOVING, arm_moving=True, t=21.0)
    seen.after(mode=Mode.STOPPING, t=21.5)
    told = seen.after(mode=Mode.HOLDING, arm_moving=False, t=22.0)
    assert told == ["Stopped with the jaw tip at (250, -120, 150) mm after 1.0 s"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mode": Mode.LIMP}, "The arm is limp"),
        ({"mode": Mode.GUIDING}, "The arm is guided by hand"),
        ({"mode": Mode.FAULT, "fault": "no reply from servo 3"}, "Fault: no reply from servo 3"),
    ],
)
def test_modes_and_faults_are_reported_in_words(seen, changes, words):
    assert seen.after(**changes) == [words]
    assert seen.after(mode=Mode.HOLDING) == ["The arm holds"]


def test_a_plan_and_a_lost_source_are_reported_once_and_the_latter_not_as_a_fault_too(seen):
    plan = SimpleNamespace(trajectory=SimpleNamespace(duration=2.34))
    seen.arm.newest = (None, plan)
    assert seen.after() == ["Planned a 2.3 s motion"]
    assert seen.after() == []
    seen.rig.connection = ArmConnection(to="arm on X", problem="the port went away")
    told = seen.after(mode=Mode.FAULT, fault="the port went away")
    assert told == ["Lost the arm on X: the port went away"]
    seen.rig.connection = ArmConnection(to="arm on X")
    assert seen.after() == ["The arm on X is back; nothing moves until you ask"]


def test_the_log_is_bounded_and_saved_as_lines_with_date_and_time_the_oldest_first():
    log = EventLog()
    for k in range(KEPT + 10):
        log.add(f"event {k}")
    assert log.count == KEPT + 10
    assert len(log.newest()) == KEPT
    assert log.newest(2)[0].text == f"event {KEPT + 9}"
    log = EventLog()
    log.add("first")
    log.add("second.")
    log.add("second")  # the same at once is one event
    first, second = log.text().splitlines()
    assert first.endswith(" first")
    assert second.endswith(" second")
    assert len(first.split()[0]) == len("2026-01-01")
    assert EventLog().text() == ""


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
    assert tracking.lag == pytest.approx(lag, abs=0.01)
    assert tracking.t[0] == 0.0
    assert tracking.t[-1] == pytest.approx(2.0)
    np.testing.assert_allclose(tracking.worst, np.pi * lag, atol=bias + 1e-9)
    assert np.all(tracking.rms <= tracking.worst + 1e-12)


def test_the_limit_a_motion_comes_nearest_to_is_the_one_that_is_drawn():
    bounds = (np.array([-2.0, -2.0, -1.0, -2.0, -2.0]), np.array([2.0, 1.5, 2.0, 2.0, 2.0]))
    assert nearest_limit(np.array([[0.0, 0.5, -0.7, 0.0, 0.0], [0.1] * 5]), bounds) == -1.0
    assert nearest_limit(np.array([[0.0, 1.4, -0.7, 0.0, 0.0]]), bounds) == 1.5
