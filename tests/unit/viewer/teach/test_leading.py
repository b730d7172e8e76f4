"""Following a leader on another port of this computer."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from so101_viewer.teach.leading import OFF, Leading, LocalSession

from so101_motion.common.modes import Mode
from so101_motion.rig.rig import Rig
from so101_motion.rig.simulated_rig import open_simulated


@pytest.fixture
def arms() -> Iterator[tuple[Rig, Rig]]:
    away = np.radians([50.0, -45.0, 45.0, 60.0, 0.0])
    with open_simulated() as follower, open_simulated(q_start=away) as leader:
        yield follower, leader


def test_a_stop_while_the_leader_is_being_opened_moves_nothing(arms: tuple[Rig, Rig]) -> None:
    follower, leader = arms
    begun, go_on = threading.Event(), threading.Event()

    def open_leader() -> Rig:
        begun.set()
        assert go_on.wait(30.0)
        return leader

    before = follower.arm.state.q_ref
    with ThreadPoolExecutor(1) as pool:
        leading = Leading(LocalSession(follower, open_leader), pool.submit)
        leading.toggle()
        assert begun.wait(30.0)
        leading.end()
        go_on.set()
        pool.submit(int).result(30.0)  # the only thread is free again
        leading.refresh()
    assert "Stopped" in leading.sentence.text
    assert leader.arm.state.mode is Mode.HOLDING
    np.testing.assert_array_equal(follower.arm.state.q_ref, before)
    leading.close()


def test_a_stop_before_a_thread_is_free_opens_nothing(arms: tuple[Rig, Rig]) -> None:
    follower, leader = arms
    opened: list[Rig] = []

    def open_leader() -> Rig:
        opened.append(leader)
        return leader

    blocked = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        pool.submit(blocked.wait, 30.0)
        leading = Leading(LocalSession(follower, open_leader), pool.submit)
        assert leading.sentence == OFF
        leading.toggle()
        leading.end()
        blocked.set()
    assert opened == []
    leading.close()
