"""Following a leader, switched on the Teach tab, on a clock the test drives."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from so101_viewer.teach.leading import OFF, Leading, LocalSession, session_for

from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import BusError
from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.rig.rig import Rig
from so101_motion.rig.simulated_rig import open_simulated

AWAY = np.radians([25.0, -15.0, 10.0, 10.0, 0.0])


class Bench:
    """An arm, a worker, and time that passes while something is waited for."""

    def __init__(self, rig: Rig, clock: ManualClock) -> None:
        self.rig, self.clock = rig, clock
        self.worker = ThreadPoolExecutor(max_workers=1)

    def submit(self, call: Callable[[], Any]) -> Future[Any]:
        return self.worker.submit(call)

    def until(self, condition: Callable[[], object], refresh: Callable[[], object]) -> None:
        end = time.monotonic() + 60.0  # planner and worker take real time
        while time.monotonic() < end:
            refresh()
            if condition():
                return
            self.clock.advance(0.01)
        pytest.fail("did not come true")


@pytest.fixture
def bench(clock: ManualClock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    with open_simulated(clock=clock, speed=to_rad(180.0), acceleration=to_rad(500.0)) as rig:
        bench = Bench(rig, clock)
        yield bench
        bench.worker.shutdown()


def test_one_button_lets_the_arm_follow_a_leader_and_ends_it(bench: Bench) -> None:
    leader = open_simulated(clock=bench.clock)
    session = session_for(bench.rig, lambda: leader)
    assert isinstance(session, LocalSession)
    leading = Leading(session, bench.submit, bench.clock.now)
    assert leading.sentence == OFF
    leading.toggle()
    bench.until(lambda: leading.can_switch and leading.is_on, leading.refresh)
    assert leader.arm.state.mode is Mode.LIMP
    bench.until(lambda: leading.sentence.text == "Following the leader.", leading.refresh)
    leading.toggle()
    bench.until(lambda: leading.can_switch and not leading.is_on, leading.refresh)
    assert leader.arm.state.mode is Mode.HOLDING
    assert leading.sentence == OFF
    closing = bench.submit(leading.close)
    bench.until(closing.done, leading.refresh)


def test_an_ended_following_stays_ended_though_the_leader_it_waited_for_comes_back(
    bench: Bench,
) -> None:
    leader = open_simulated(clock=bench.clock)
    session = session_for(bench.rig, lambda: leader)
    assert session is not None
    leading = Leading(session, bench.submit, bench.clock.now)
    leading.toggle()
    bench.until(lambda: leading.sentence.text == "Following the leader.", leading.refresh)
    leader.executor.call(lambda driver: driver.push(AWAY))
    bench.until(lambda: leading.sentence.text.startswith("Holding: "), leading.refresh)
    ending = bench.submit(leading.end)  # as Stop on the page does
    bench.until(lambda: ending.done() and not leading.is_on, leading.refresh)
    assert leader.arm.state.mode is Mode.HOLDING
    before = bench.rig.arm.state.q
    leader.executor.call(lambda driver: driver.push(before))
    for _ in range(100):
        leading.refresh()
        bench.clock.advance(0.02)
    np.testing.assert_allclose(bench.rig.arm.state.q, before, atol=1e-6)
    closing = bench.submit(leading.close)
    bench.until(closing.done, leading.refresh)


def test_a_leader_that_cannot_be_opened_is_reported(bench: Bench) -> None:
    def nobody() -> Rig:
        raise BusError("there is no such port")

    session = session_for(bench.rig, nobody)
    assert session is not None
    leading = Leading(session, bench.submit, bench.clock.now)
    leading.toggle()
    bench.until(lambda: leading.can_switch, leading.refresh)
    assert leading.sentence.text == "There is no such port."
    assert not leading.is_on
    leading.close()
    assert session_for(bench.rig, None) is None
