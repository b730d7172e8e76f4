"""Following a leader as an operation, on a clock the test drives."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from functools import partial

import numpy as np
import pytest
from so101_viewer.teach.teach_panel import leading_of

from so101_motion.arm.stop_order import mark_request
from so101_motion.common.errors import BusError, Interrupted
from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.tasks.teleop.leading import OFF, LeadingOperation
from so101_motion.viam.client import MachineRig

AWAY = np.radians([25.0, -15.0, 10.0, 10.0, 0.0])


class Bench:
    """Two arms, a worker, and time that passes while something is waited for."""

    def __init__(self, rig, leader, clock):
        self.rig, self.leader, self.clock = rig, leader, clock
        self.operation = LeadingOperation(rig, lambda: leader)
        self.worker = ThreadPoolExecutor(max_workers=2)

    def ask(self, command):
        """As a button that is pressed now."""
        asked = copy_context()
        asked.run(mark_request)
        return self.worker.submit(asked.run, self.operation.ask, command)

    def until(self, condition):
        end = time.monotonic() + 60.0  # planner and worker take real time
        while not condition():
            assert time.monotonic() < end, "did not come true"
            self.clock.advance(0.01)

    def done(self, future):
        self.until(future.done)
        return future.result()


@pytest.fixture
def bench(clock, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    leader = open_simulated(clock=clock)
    with open_simulated(clock=clock, speed=to_rad(180.0), acceleration=to_rad(500.0)) as rig:
        bench = Bench(rig, leader, clock)
        yield bench
        bench.done(bench.worker.submit(bench.operation.close))
        bench.done(bench.worker.submit(leader.close))
        bench.worker.shutdown()


def test_the_arm_follows_a_leader_until_it_is_ended(bench):
    operation, leader = bench.operation, bench.leader
    assert operation.view.text == OFF
    bench.done(bench.ask("start"))
    assert leader.arm.state.mode is Mode.LIMP
    bench.until(lambda: operation.view.text == "Following the leader.")
    leader.executor.call(lambda driver: driver.push(AWAY))
    bench.until(lambda: operation.view.text.startswith("Holding: "))
    bench.done(bench.ask("stop"))
    assert operation.view.text == OFF
    assert leader.arm.state.mode is Mode.HOLDING
    before = bench.rig.arm.state.q
    leader.executor.call(lambda driver: driver.push(before))  # it is brought back, too late
    for _ in range(100):
        bench.clock.advance(0.02)
    np.testing.assert_allclose(bench.rig.arm.state.q, before, atol=1e-6)


def test_a_leader_that_cannot_be_opened_is_reported(bench):
    def nobody():
        raise BusError("there is no such port")

    bench.operation = LeadingOperation(bench.rig, nobody)
    with pytest.raises(BusError):
        bench.done(bench.ask("start"))
    assert bench.operation.view.text == OFF


def test_a_stop_while_the_leader_is_being_opened_moves_nothing(bench):
    begun, go_on = threading.Event(), threading.Event()

    def open_leader():
        begun.set()
        assert go_on.wait(60.0)
        return bench.leader

    before = bench.rig.arm.state.q_ref
    bench.operation = LeadingOperation(bench.rig, open_leader)
    starting = bench.ask("start")
    assert begun.wait(60.0)
    bench.done(bench.ask("stop"))
    go_on.set()
    with pytest.raises(Interrupted):
        bench.done(starting)
    assert bench.leader.arm.state.mode is Mode.HOLDING
    np.testing.assert_array_equal(bench.rig.arm.state.q_ref, before)


class _Machine(MachineRig):
    """A machine that notes what it is asked."""

    def __init__(self):
        self.asked = []

    def do_command(self, name, command, **_):
        self.asked.append(command["command"])
        return {"running": False, "consecutive_errors": 0}

    @property
    def resources(self):
        return (type("Resource", (), {"name": "teleop", "api": "service:generic"})(),)


@pytest.mark.parametrize("is_on_machine", [False, True])
def test_a_stop_before_a_thread_is_free_begins_nothing(bench, is_on_machine):
    machine, opened = _Machine(), []

    def open_leader():
        opened.append(bench.leader)
        return bench.leader

    operation = leading_of(machine if is_on_machine else bench.rig, open_leader)
    pressed = copy_context()
    pressed.run(mark_request)
    operation.ask("stop")
    with pytest.raises(Interrupted):
        pressed.run(partial(operation.ask, "start"))
    assert opened == []
    assert "start" not in machine.asked
    pressed.run(partial(operation.ask, "stop"))
    operation.close()
