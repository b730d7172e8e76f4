"""Recording while a hand guides the arm."""

import numpy as np
import pytest

from so101_motion.common.errors import MotionError
from so101_motion.common.modes import Mode
from so101_motion.tasks.guided import PathRecorder
from so101_motion.tasks.guided import recorder as recorder_module

CORNERS = ([20, -10, 10, 0, 0], [20, -30, 30, 10, -40])


@pytest.fixture
def guided(guest):
    guest.rig.arm.set_manual(True)
    return guest


def recorded(guest, gripper=None):
    return PathRecorder(guest.rig.executor, gripper)


def test_the_path_of_the_hand_is_recorded_with_its_time(guided):
    recorder = recorded(guided)
    for corner in CORNERS:
        guided.lead(corner)
        assert np.degrees(recorder.path.q[-1]) == pytest.approx(corner, abs=1e-6), "so far"
    path = recorder.end()
    assert path.duration == pytest.approx(1.98, abs=0.05)
    assert path.aperture is None
    corner = int(np.argmin(np.abs(path.q - np.radians(CORNERS[0])).max(axis=1)))
    assert path.t[corner] == pytest.approx(1.0, abs=0.05)
    assert np.degrees(path.q[-1]) == pytest.approx(CORNERS[1], abs=1e-6)
    assert recorder.ended_by == ""
    assert guided.rig.arm.state.mode is Mode.GUIDING
    guided.lead([0, 0, 0, 0, 0])
    assert recorder.end() is path, "it is over"


def test_a_hand_that_rests_costs_nothing_and_the_end_is_kept(guided):
    recorder = recorded(guided)
    guided.lead(CORNERS[0])
    points = recorder.points
    guided.clock.advance(100.0)
    assert recorder.points == points
    path = recorder.end()
    assert path.duration == pytest.approx(101.0, abs=0.1)
    assert len(path) < 130


def test_it_ends_when_the_arm_is_let_go_of_or_lost(guided):
    recorder = recorded(guided)
    guided.rig.executor.release().result()
    guided.clock.advance(0.1)
    assert recorder.ended_by == "the arm was released"
    recorder = recorded(guided)  # an arm without torque is led by hand as well
    guided.lead(CORNERS[0])
    guided.rig.executor.call(lambda driver: driver.disconnect(ConnectionError("cable")))
    guided.clock.advance(0.1)
    assert "cable" in recorder.ended_by
    assert np.degrees(recorder.end().q[-1]) == pytest.approx(CORNERS[0], abs=1e-6)
    guided.rig.executor.call(lambda driver: driver.reconnect())


def test_it_does_not_grow_for_ever(guided, monkeypatch):
    monkeypatch.setattr(recorder_module, "MOST", 30)
    recorder = recorded(guided)
    guided.lead(CORNERS[0])
    assert "at most 30 points" in recorder.ended_by
    assert len(recorder.end()) == 30


def test_an_arm_that_holds_shows_nothing(guest):
    with pytest.raises(MotionError, match="enter manual mode first"):
        recorded(guest)
