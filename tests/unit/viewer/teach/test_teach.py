"""The Teach tab's models on simulated arms, on a clock the test drives."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from so101_viewer.teach.leading import OFF, Leading, LocalSession, session_for
from so101_viewer.teach.path_teaching import PathTeaching
from so101_viewer.teach.teaching import ARM_MOVED, Doing

from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import BusError, ConfigError
from so101_motion.common.geometry import Array
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
        self.teaching = PathTeaching(rig, self.submit)

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

    def taught(self, condition: Callable[[], object]) -> None:
        self.until(condition, self.teaching.refresh)

    def lead(self, q: Array, *, steps: int = 50) -> None:
        here = self.rig.arm.state.q
        for share in np.linspace(0.0, 1.0, steps)[1:]:
            push = here + share * (q - here)
            self.rig.executor.call(lambda driver, push=push: driver.push(push))
            self.clock.advance(0.01)

    def record(self) -> None:
        self.teaching.record()
        self.taught(lambda: self.teaching.doing is Doing.RECORDING)
        self.lead(AWAY)
        self.teaching.end_recording()
        self.taught(lambda: self.rig.arm.state.mode is Mode.HOLDING)


@pytest.fixture
def bench(clock: ManualClock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    with open_simulated(clock=clock, speed=to_rad(180.0), acceleration=to_rad(500.0)) as rig:
        bench = Bench(rig, clock)
        yield bench
        bench.worker.shutdown()


def test_a_path_is_recorded_planned_replayed_and_kept(bench: Bench) -> None:
    teaching = bench.teaching
    assert not teaching.can_plan
    assert "simulated arm cannot be guided by hand" in teaching.sentence.text
    teaching.record()
    bench.taught(lambda: teaching.sentence.text.startswith("Recording"))
    assert "A simulated arm stands still. It holds again in" in teaching.sentence.text
    bench.lead(AWAY)
    teaching.end_recording()
    bench.taught(lambda: bench.rig.arm.state.mode is Mode.HOLDING)
    path = teaching.path
    assert path is not None
    np.testing.assert_allclose(path.q[-1], AWAY, atol=to_rad(0.1))
    np.testing.assert_allclose(bench.rig.arm.state.q, AWAY, atol=to_rad(0.1))

    teaching.plan()
    bench.taught(lambda: teaching.can_run)
    assert "to its start" in teaching.sentence.text
    np.testing.assert_allclose(bench.rig.arm.state.q, AWAY, atol=to_rad(0.1))  # nothing moved
    teaching.run()
    assert teaching.doing is Doing.REPLAYING
    far: list[float] = []

    def is_done() -> bool:
        far.append(float(np.abs(bench.rig.arm.state.q - AWAY).max()))
        return teaching.doing is Doing.NOTHING

    bench.taught(is_done)
    assert max(far) > to_rad(20.0)  # it went to the beginning
    np.testing.assert_allclose(bench.rig.arm.state.q, AWAY, atol=to_rad(0.5))
    assert teaching.sentence.text.startswith("Done.")

    with pytest.raises(ConfigError, match="type a name first"):
        teaching.save()
    teaching.call("wave")
    teaching.save()
    assert teaching.saved_files.names == ("wave",)
    teaching.load("wave")
    assert teaching.path is not path
    teaching.delete("wave")
    assert teaching.saved_files.names == ()
    teaching.saved_files.undo()
    teaching.load("wave")


def test_a_recording_may_be_ended_the_moment_it_begins(bench: Bench) -> None:
    teaching = bench.teaching
    for _ in range(3):
        teaching.record()
        bench.taught(lambda: teaching.doing is Doing.RECORDING)
        teaching.end_recording()
        assert teaching.doing is Doing.NOTHING
        assert teaching.path is not None
        bench.taught(lambda: teaching.can_plan)
    assert bench.rig.arm.state.mode is Mode.HOLDING


def test_a_path_that_was_not_saved_survives_the_next(bench: Bench) -> None:
    teaching = bench.teaching
    bench.record()
    first = teaching.path
    bench.record()
    assert first is not None
    assert teaching.saved_files.names == ("unsaved 1",)
    assert teaching.sentence.text.endswith('The path before is saved as "unsaved 1".')

    teaching.load("unsaved 1")  # and the second is kept as well
    assert teaching.saved_files.names == ("unsaved 1", "unsaved 2")
    assert teaching.path is not None
    np.testing.assert_allclose(teaching.path.q[-1], first.q[-1], atol=1e-5)
    teaching.load("unsaved 2")  # what was saved is not saved again
    assert teaching.saved_files.names == ("unsaved 1", "unsaved 2")
    teaching.delete("unsaved 2")  # and what was deleted is
    bench.record()
    assert teaching.saved_files.names == ("unsaved 1", "unsaved 2")


def test_a_stop_ends_the_recording_and_what_was_shown_is_kept(bench: Bench) -> None:
    teaching = bench.teaching
    teaching.record()
    bench.taught(lambda: teaching.doing is Doing.RECORDING)
    bench.taught(lambda: "Recording, 1 point. " in teaching.sentence.text)
    bench.lead(AWAY)
    stopping = bench.submit(bench.rig.arm.stop)
    bench.taught(lambda: stopping.done() and teaching.doing is Doing.NOTHING)
    assert teaching.path is not None
    assert "manual mode ended" in teaching.sentence.text


def test_a_replay_is_planned_anew_when_the_arm_was_moved(bench: Bench) -> None:
    teaching = bench.teaching
    bench.record()
    teaching.plan()
    bench.taught(lambda: teaching.can_run)
    moving = bench.rig.arm.move(_joints(np.zeros(5)), wait=False)
    bench.taught(moving.future.done)
    bench.taught(lambda: teaching.sentence is ARM_MOVED)
    assert not teaching.can_run


def _joints(q: Array) -> Any:
    from so101_motion.planning.goals import JointGoal

    return JointGoal(q=q)


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
