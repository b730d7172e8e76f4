"""The Teach tab's model of a machine, on an arm of our module in this process."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from grpclib import GRPCError
from harness.in_process_module import new_arm
from so101_viewer.teach.machine_teaching import CANNOT, MOST_NAMES, MachineTeaching
from so101_viewer.teach.teaching import ARM_MOVED, DONE, WELCOME, Doing

from so101_motion.arm.arm import Arm
from so101_motion.arm.motion_handle import Motion
from so101_motion.common.errors import MachineRefused
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.state import JointState
from so101_motion.common.units import to_rad
from so101_motion.planning.goals import JointGoal
from so101_motion.rig.protocols import ArmConnection

AWAY = np.radians([25.0, -15.0, 10.0, 10.0, 0.0])


class LateArm:
    """An arm whose state is reported late."""

    def __init__(self, arm: Arm, state: JointState) -> None:
        self._arm, self.state = arm, state

    def __getattr__(self, name: str) -> Any:
        return getattr(self._arm, name)


class Machine:
    """A machine with one simulated arm of our module, without a network."""

    arm_name = "arm"
    connection = ArmConnection(to="machine")

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever)
        self._thread.start()
        self.component = self._run(self._new())
        self.clock = self.component.rig.clock
        self.sent: list[Mapping[str, Any]] = []
        self.late: JointState | None = None  # an older state, reported instead of the present one

    async def _new(self) -> Any:
        fast = {"speed_degs_per_sec": 180.0, "acceleration_degs_per_sec_per_sec": 500.0}
        return new_arm(simulate_time=False, **fast)

    def _run(self, work: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self.loop).result(60.0)

    @property
    def arm(self) -> Arm:
        arm: Arm = self.component.rig.arm
        return arm if self.late is None else cast(Arm, LateArm(arm, self.late))

    def do_command(self, resource: str, command: Mapping[str, Any]) -> Mapping[str, Any]:
        assert resource == self.arm_name
        self.sent.append(command)
        try:
            answer: Mapping[str, Any] = self._run(self.component.do_command(command))
        except GRPCError as error:
            refused = MachineRefused("arm", error.status.name, error.message or "")
            raise refused from error
        return answer

    def start_request(self, command: Mapping[str, Any]) -> Motion:
        motion = Motion()

        def move() -> None:
            try:
                self.do_command(self.arm_name, command)
            except MachineRefused as error:
                motion.future.set_exception(error)
            else:
                motion.future.set_result(None)

        threading.Thread(target=move).start()
        return motion

    def refresh(self) -> JointState:
        return self.arm.state

    def close(self) -> None:
        self._run(self.component.close())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join()
        self.loop.close()


class OtherModule(Machine):
    """An arm whose module answers every DoCommand with the same command, as some do."""

    def do_command(self, resource: str, command: Mapping[str, Any]) -> Mapping[str, Any]:
        return command


class Bench:
    """A machine, a page's model of it, and time that passes while something is waited for."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.worker = ThreadPoolExecutor(max_workers=4)
        self.teaching = self.another()

    def another(self) -> MachineTeaching:
        """The model of one more page of the same machine."""
        return MachineTeaching(self.machine, self.submit)

    def submit(self, call: Callable[[], Any]) -> Future[Any]:
        return self.worker.submit(call)

    def until(
        self, condition: Callable[[], object], teaching: MachineTeaching | None = None
    ) -> None:
        end = time.monotonic() + 60.0  # planner and threads take real time
        while time.monotonic() < end:
            (teaching or self.teaching).refresh()
            if condition():
                return
            self.machine.do_command("arm", {"command": "advance_time", "seconds": 0.01})
        pytest.fail(f"did not come true; it said: {(teaching or self.teaching).sentence.text}")

    def lead(self, q: Array) -> None:
        executor, here = self.machine.component.rig.executor, self.machine.arm.state.q
        for share in np.linspace(0.0, 1.0, 50)[1:]:
            push = here + share * (q - here)
            executor.call(lambda driver, push=push: driver.push(push))
            self.machine.do_command("arm", {"command": "advance_time", "seconds": 0.01})

    def record(self) -> None:
        self.until(lambda: self.teaching.can_record)
        self.teaching.record()
        assert self.teaching.doing is Doing.BEGINNING
        self.until(lambda: self.teaching.doing is Doing.RECORDING)
        self.lead(AWAY)
        self.teaching.end_recording()
        self.until(lambda: self.teaching.can_plan)


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setenv("VIAM_MODULE_DATA", str(tmp_path))
    machine = Machine()
    bench = Bench(machine)
    yield bench
    bench.worker.shutdown()
    machine.close()


def commands(machine: Machine) -> list[object]:
    names = [each["command"] for each in machine.sent]
    return [each for each in names if each not in ("advance_time", "list_paths")]


def test_a_path_is_recorded_on_the_machine_planned_and_replayed(bench: Bench) -> None:
    teaching, arm = bench.teaching, bench.machine.arm
    assert teaching.sentence is WELCOME
    teaching.call("wave")
    bench.record()
    assert arm.state.mode is Mode.HOLDING
    assert teaching.sentence.text.startswith('"wave" is saved: ')
    assert (teaching.chosen, teaching.names) == ("wave", ("wave",))
    np.testing.assert_allclose(arm.state.q, AWAY, atol=to_rad(0.1))

    teaching.plan()
    bench.until(lambda: teaching.can_run)
    assert "s to its start" in teaching.sentence.text
    assert teaching.line is not None
    np.testing.assert_allclose(teaching.line[-1], arm.model.frame(AWAY).p, atol=2e-3)
    np.testing.assert_allclose(arm.state.q, AWAY, atol=to_rad(0.1))  # nothing moved
    teaching.run()
    assert teaching.doing is Doing.REPLAYING
    far: list[float] = []

    def is_done() -> bool:
        far.append(float(np.abs(arm.state.q - AWAY).max()))
        return teaching.doing is Doing.NOTHING

    bench.until(is_done)
    assert max(far) > to_rad(20.0)  # it went to the beginning
    np.testing.assert_allclose(arm.state.q, AWAY, atol=to_rad(0.5))
    assert teaching.sentence is DONE
    assert commands(bench.machine) == ["record_path", "end_path", "replay_path", "replay_path"]


def test_a_path_of_the_same_name_is_kept_and_the_new_one_gets_a_number(bench: Bench) -> None:
    bench.teaching.call("wave")
    bench.record()
    bench.record()
    assert bench.teaching.names == ("wave", "wave 2")
    assert bench.teaching.chosen == "wave 2"
    bench.teaching.plan()
    bench.until(lambda: bench.teaching.line is not None)
    bench.teaching.load("wave")
    assert bench.teaching.chosen == "wave"
    assert bench.teaching.line is None, "it is of the other path"


@pytest.mark.parametrize("told", [None, 3, [], [[1.0, 2.0]], [[1.0, "x", 2.0]], [[0.0] * 3] * 1001])
def test_a_machine_that_tells_no_line_or_a_wrong_one_has_its_replay_planned_all_the_same(
    bench: Bench, told: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    teaching, send = bench.teaching, bench.machine.do_command
    bench.record()
    monkeypatch.setattr(
        bench.machine,
        "do_command",
        lambda name, command: {**send(name, command), "tool_path_mm": told},
    )
    teaching.plan()
    bench.until(lambda: teaching.can_run)
    assert teaching.line is None


def test_what_is_deleted_on_the_machine_comes_back_by_undo_and_goes_by_redo(bench: Bench) -> None:
    teaching, files = bench.teaching, bench.teaching.saved_files

    def do(what: Callable[[], None], names: tuple[str, ...]) -> str:
        bench.until(lambda: teaching.can_record)
        what()
        bench.until(lambda: teaching.names == names)
        return teaching.sentence.text

    bench.record()
    assert not files.can_undo
    assert do(lambda: teaching.delete("path"), ()) == "Deleted path."
    assert not teaching.can_plan
    assert do(files.undo, ("path",)) == "Undone: the saved files are as before."
    assert (files.can_undo, files.can_redo) == (False, True)
    assert do(files.redo, ()) == "Redone."
    assert (files.can_undo, files.can_redo) == (True, False)

    bench.record()  # another one of the same name
    bench.until(lambda: teaching.can_record)
    files.undo()
    bench.until(lambda: "is there already" in teaching.sentence.text)
    assert not files.can_undo, "what the machine refuses once is not asked again"


def test_a_recording_that_the_machine_ends_is_kept_and_it_is_said_why(bench: Bench) -> None:
    teaching = bench.teaching
    bench.until(lambda: teaching.can_record)
    teaching.record()
    bench.until(lambda: teaching.doing is Doing.RECORDING)
    assert teaching.sentence.text.startswith('Recording "path", 0 s. Guide the arm by hand. It')
    bench.lead(AWAY)
    bench.machine.arm.start_stop()
    bench.until(lambda: teaching.doing is Doing.NOTHING)
    assert teaching.sentence.text.startswith("The recording ended: manual mode ended. ")
    bench.until(lambda: teaching.can_plan)


def test_a_late_report_of_the_mode_does_not_end_a_recording(bench: Bench) -> None:
    teaching, machine = bench.teaching, bench.machine
    bench.until(lambda: teaching.can_record)
    before = machine.arm.state
    teaching.record()
    bench.until(lambda: teaching.doing is Doing.RECORDING)
    machine.late = before
    asked = len(machine.sent)
    bench.until(lambda: [each["command"] for each in machine.sent[asked:]].count("list_paths") > 2)
    machine.late = None
    assert teaching.doing is Doing.RECORDING
    teaching.end_recording()
    bench.until(lambda: teaching.can_plan)
    assert teaching.sentence.text.startswith('"path" is saved: ')
    assert commands(machine) == ["record_path", "end_path"]


def test_a_recording_of_another_client_is_shown_and_can_be_ended(bench: Bench) -> None:
    teaching, other = bench.teaching, bench.another()
    bench.until(lambda: teaching.can_record)
    bench.until(lambda: other.can_record, other)
    other.call("theirs")
    other.record()
    bench.until(lambda: other.doing is Doing.RECORDING, other)
    bench.until(lambda: teaching.sentence.text == 'Recording "theirs". Guide the arm by hand.')
    assert not teaching.can_record
    teaching.end_recording()
    bench.until(lambda: teaching.can_plan)
    assert teaching.chosen == "theirs"
    bench.until(lambda: other.doing is Doing.NOTHING, other)


def test_a_plan_is_dropped_when_the_arm_was_moved(bench: Bench) -> None:
    teaching = bench.teaching
    bench.record()
    teaching.plan()
    bench.until(lambda: teaching.can_run)
    bench.machine.arm.move(JointGoal(q=np.zeros(5)), wait=False)
    bench.until(lambda: teaching.sentence is ARM_MOVED)
    assert not teaching.can_run


def test_a_refusal_is_shown_in_the_machines_words(bench: Bench) -> None:
    teaching = bench.teaching
    bench.until(lambda: teaching.can_record)
    teaching.call("../elsewhere")
    teaching.record()
    bench.until(lambda: teaching.doing is Doing.NOTHING)
    assert teaching.sentence.text.startswith("The machine says: ")
    assert "letters, digits" in teaching.sentence.text
    bench.until(lambda: teaching.can_record)


def test_the_names_of_a_huge_list_are_bounded(bench: Bench) -> None:
    answer: dict[str, Any] = {
        "paths": [{"name": f"path {k}"} for k in range(3 * MOST_NAMES)]
        + [{"name": 7}, "nothing", {"name": "x" * 999}],
        "recording": "",
    }
    bench.machine.do_command = lambda resource, command: answer  # type: ignore[method-assign]
    bench.teaching.refresh()
    end = time.monotonic() + 60.0
    while not bench.teaching.names and time.monotonic() < end:
        bench.teaching.refresh()
    assert len(bench.teaching.names) == MOST_NAMES
    del bench.machine.do_command  # type: ignore[method-assign]


def test_an_arm_of_another_module_is_told_to_be_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VIAM_MODULE_DATA", str(tmp_path))
    bench = Bench(OtherModule())
    bench.until(lambda: bench.teaching.sentence is CANNOT)
    assert not bench.teaching.can_record
    bench.teaching.record()
    assert bench.teaching.doing is Doing.NOTHING
    bench.worker.shutdown()
    bench.machine.close()
