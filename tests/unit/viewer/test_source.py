from __future__ import annotations

import json
import threading
from datetime import datetime
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from so101_viewer import source
from so101_viewer.page.bar import Bar
from so101_viewer.panels.hold_buttons import notice, waiting
from so101_viewer.source import Source, SourceOpener

from so101_motion.common.errors import PortUnavailable
from so101_motion.common.modes import Mode
from so101_motion.common.state import JointReading, JointState
from so101_motion.rig.protocols import ArmConnection

AT = datetime(2026, 5, 4, 12, 30, 15)


def state(mode: Mode, fault: str | None = None) -> JointState:
    return JointState(
        t=0.0,
        mode=mode,
        reading=JointReading(q=np.zeros(5), qd=np.zeros(5), q_jaw=0.0, qd_jaw=0.0),
        q_ref=np.zeros(5),
        qd_ref=np.zeros(5),
        q_jaw_ref=0.0,
        arm_moving=False,
        jaw_moving=False,
        late_ticks=0,
        fault=fault,
    )


class Finder:
    """A source that is not there the first so many times, and who looks for it."""

    def __init__(self, failures: int) -> None:
        self.failures = failures
        self.errors: list[Exception] = []
        self.found = threading.Event()
        self.closed = threading.Event()
        self.may_open = threading.Event()
        self.may_open.set()
        self.opening = threading.Event()

    def open(self) -> Any:
        self.opening.set()
        assert self.may_open.wait(60.0)
        if len(self.errors) < self.failures:
            raise PortUnavailable("/dev/ttyACM0", "there is no such port")
        return SimpleNamespace(close=self.closed.set)

    def search(self) -> SourceOpener:
        return SourceOpener(
            Source(title="Arm", open=self.open).open,
            found=lambda _rig: self.found.set(),
            failed=self.errors.append,
        )


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "LOOK_AGAIN", 0.01)


def test_an_arm_is_looked_for_until_it_is_there() -> None:
    finder = Finder(3)
    search = finder.search()
    assert finder.found.wait(60.0)
    search.close()
    assert len(finder.errors) == 3
    assert not finder.closed.is_set()


def test_a_search_that_is_given_up_ends_and_closes_what_it_still_found() -> None:
    finder = Finder(0)
    finder.may_open.clear()
    search = finder.search()
    assert finder.opening.wait(60.0)
    ending = threading.Thread(target=search.close)
    ending.start()
    while not search.closing.is_set():
        pass
    finder.may_open.set()
    ending.join(60.0)
    assert finder.closed.is_set()
    assert not finder.found.is_set()


def test_while_there_is_no_arm_the_page_says_which_why_and_that_it_looks_on() -> None:
    bar = Bar()
    gone = PortUnavailable("/dev/ttyACM0", "there is no such port")
    waiting(bar, "Arm on /dev/ttyACM0", gone)
    told = json.loads(bar.text())
    assert (told["state"], told["title"]) == ("No arm yet", "Arm on /dev/ttyACM0")
    (alert,) = told["alerts"]
    assert "there is no such port" in alert["text"]
    assert alert["text"].endswith("Still looking.")
    assert alert["tone"] == "bad"


def test_a_lost_arm_is_said_with_the_time_the_reason_and_what_happens_next() -> None:
    port = "/dev/ttyACM0"
    lost = ArmConnection(to=f"arm on {port}", problem=f"{port}: the port went away")
    said = notice(lost, state(Mode.FAULT, "the port went away"), AT)
    assert said is not None
    assert said.text.startswith("Lost the arm on /dev/ttyACM0 at 12:30:15. The port went away.")
    assert "nothing will move" in said.text
    assert "Hold" not in said.text, "there is nothing to hold"


@pytest.mark.parametrize("mode", [Mode.LIMP, Mode.GUIDING, Mode.FAULT])
def test_an_arm_that_is_there_but_not_held_can_be_held(mode: Mode) -> None:
    said = notice(ArmConnection(to="arm"), state(mode), AT)
    assert said is not None
    assert "press Hold" in said.text.lower().replace("hold", "Hold")


def test_a_simulated_arm_is_not_said_to_feel_a_hand() -> None:
    connection = ArmConnection(to="simulated arm", is_simulated=True)
    said = notice(connection, state(Mode.GUIDING), AT)
    assert said is not None
    assert said.text.startswith("A real arm could be moved by hand now; a simulated one cannot.")


def test_a_fault_is_said_without_the_file_that_was_kept() -> None:
    kept = "no reply from servo 4; check its cable. The second before is in /home/a.json"
    said = notice(ArmConnection(to="arm"), state(Mode.FAULT, kept), AT)
    assert said is not None
    end = "Fix this, then press Hold."
    assert said.text == f"Fault: no reply from servo 4; check its cable. {end}"


def test_an_arm_that_is_back_is_not_said_to_be_missing() -> None:
    back, then = ArmConnection(to="arm on /dev/ttyACM0"), state(Mode.FAULT, "no such port")
    said = notice(back, then, AT, is_back=True)
    assert said is not None
    assert said.text == "Connected again. Nothing moves. Press Hold to go on."


def test_what_to_do_after_a_restart_is_said_once() -> None:
    cause = "servo 4 restarted: check its cable, then let the arm hold again"
    said = notice(ArmConnection(to="arm"), state(Mode.FAULT, cause), AT)
    assert said is not None
    assert said.text == "Fault: servo 4 restarted: check its cable. Fix this, then press Hold."


@pytest.mark.parametrize("mode", [Mode.HOLDING, Mode.MOVING, Mode.STOPPING, Mode.CALIBRATING])
def test_of_an_arm_that_is_well_nothing_is_said(mode: Mode) -> None:
    assert notice(ArmConnection(to="arm"), state(mode), AT) is None
