import json
import threading
from dataclasses import replace
from datetime import datetime
from types import SimpleNamespace

import pytest
from harness.fake_page import STILL
from so101_viewer import source
from so101_viewer.page import texts
from so101_viewer.page.bar import Bar
from so101_viewer.panels.hold_buttons import HoldButtons, notice, waiting
from so101_viewer.source import Source, SourceOpener

from so101_motion.common.errors import PortUnavailable
from so101_motion.common.modes import Mode
from so101_motion.common.state import ANSWERS_AGAIN, ARM_JOINTS, GRIPPER_JOINT
from so101_motion.rig.protocols import ArmConnection

AT = datetime(2026, 5, 4, 12, 30, 15)


def state(mode, fault=None):
    return replace(STILL, mode=mode, fault=fault)


class Finder:
    """A source that is not there the first so many times, and who looks for it."""

    def __init__(self, failures):
        self.failures = failures
        self.errors = []
        self.found = threading.Event()
        self.closed = threading.Event()
        self.may_open = threading.Event()
        self.may_open.set()
        self.opening = threading.Event()

    def open(self):
        self.opening.set()
        assert self.may_open.wait(60.0)
        if len(self.errors) < self.failures:
            raise PortUnavailable("/dev/ttyACM0", "there is no such port")
        return SimpleNamespace(close=self.closed.set)

    def search(self):
        return SourceOpener(
            Source(title="Arm", open=self.open).open,
            found=lambda _rig: self.found.set(),
            failed=self.errors.append,
        )


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(source, "LOOK_AGAIN", 0.01)


def test_an_arm_is_looked_for_until_it_is_there():
    finder = Finder(3)
    search = finder.search()
    assert finder.found.wait(60.0)
    search.close()
    assert len(finder.errors) == 3
    assert not finder.closed.is_set()


def test_a_search_that_is_given_up_ends_and_closes_what_it_still_found():
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


def test_while_there_is_no_arm_the_page_says_which_why_and_that_it_looks_on():
    bar = Bar()
    gone = PortUnavailable("/dev/ttyACM0", "there is no such port")
    waiting(bar, "Arm on /dev/ttyACM0", gone)
    told = json.loads(bar.text())
    assert (told["state"], told["title"]) == ("No arm yet", "Arm on /dev/ttyACM0")
    (alert,) = told["alerts"]
    assert "there is no such port" in alert["text"]
    assert alert["text"].endswith("Still looking.")
    assert alert["tone"] == "bad"


UNPLUGGED = "/dev/ttyACM0: there is no such port; check the USB cable and the name"
LOST = ArmConnection(to="arm on /dev/ttyACM0", problem=UNPLUGGED)
ARM = ArmConnection(to="arm")
SIMULATED = ArmConnection(to="simulated arm", is_simulated=True)
SILENT = "no reply from servo 4; check its cable"
FIX = "Fix this, then press Hold."


@pytest.mark.parametrize(
    ("connection", "mode", "fault", "says"),
    [
        (LOST, Mode.FAULT, "no such port",
         "Lost the arm on /dev/ttyACM0 at 12:30:15. There is no such port; check the USB cable."
         " While it has power, an arm that held goes on holding."
         " It reconnects by itself; nothing moves."),
        (ARM, Mode.LIMP, None, "The arm is limp. Press Hold to keep it where it is."),
        (ARM, Mode.GUIDING, None,
         "You can move the arm by hand. Press Hold to keep it where it is."),
        (SIMULATED, Mode.GUIDING, None,
         "A real arm could be moved by hand now; a simulated one cannot. Press Hold to go on."),
        (ARM, Mode.FAULT, SILENT, f"Fault: {SILENT}. {FIX}"),
        (ARM, Mode.FAULT, ANSWERS_AGAIN,
         f"Fault: {ANSWERS_AGAIN}. Nothing moves. Press Hold."),
        *((ARM, mode, None, None)
          for mode in (Mode.HOLDING, Mode.MOVING, Mode.STOPPING, Mode.CALIBRATING)),
    ],
)  # fmt: skip
def test_what_is_wrong_with_an_arm_is_said_with_what_happens_next(connection, mode, fault, says):
    said = notice(connection, state(mode, fault), AT)
    assert (None if said is None else said.text) == says
    back = notice(ARM, state(Mode.FAULT, "no such port"), AT, is_back=True)
    assert back.text == "Connected again. Nothing moves. Press Hold to go on."


def rig(mode, **reading):
    now = state(mode)
    arm = SimpleNamespace(state=replace(now, reading=replace(now.reading, **reading)), stops=0)
    return SimpleNamespace(connection=ArmConnection(to="a port"), arm=arm)


def hold_buttons(rigs):
    """The bar of these arms, and what fills it."""
    bar = Bar()
    context = SimpleNamespace(
        bar=bar, button=lambda *_args, **_named: None, post=lambda command: command()
    )
    fade = dict.fromkeys(rigs, lambda _lost: None)
    return bar, HoldButtons(context, title="Arms", rigs=rigs, guide=lambda: None, fade=fade)


def said(**modes):
    """The alerts about arms in these modes."""
    bar, buttons = hold_buttons({name: rig(mode) for name, mode in modes.items()})
    buttons.refresh()
    return [each.text for sentences in bar._alerts.values() for each in sentences]


def test_what_is_true_of_several_arms_is_said_once():
    by_hand = "You can move the arm by hand. Press Hold to keep it where it is."
    assert said(left=Mode.GUIDING, right=Mode.GUIDING) == [f"left, right: {by_hand}"]
    first, second = said(left=Mode.LIMP, right=Mode.GUIDING)
    assert first.startswith("left: The arm is limp.")
    assert second == f"right: {by_hand}"
    assert said(only=Mode.GUIDING) == [by_hand]


ALL = frozenset((*ARM_JOINTS, GRIPPER_JOINT))
NO_ONE = "The arm is limp. Press Hold to keep it where it is."


@pytest.mark.parametrize(
    ("mode", "reading", "title", "says", "let_go"),
    [
        (Mode.LIMP, {"driven": frozenset()}, "Limp", [NO_ONE], texts.LIMP_ALREADY),
        (Mode.LIMP, {"driven": ALL}, "Held, as found",
         ["The arm holds, as it was found. Press Hold to use it as it stands, or Let go."], None),
        (Mode.LIMP, {"driven": frozenset({"gripper"})}, "Held in part",
         ["The arm is limp, but gripper holds. Press Hold to use it as it stands, or Let go."],
         None),
        (Mode.LIMP, {"driven": ALL, "let_go": frozenset({"gripper"})}, "gripper has let go",
         ["The arm holds, as it was found. Press Hold to use it as it stands, or Let go."], None),
        (Mode.HOLDING, {"driven": ALL}, "Idle, holding", [], None),
        (Mode.HOLDING, {"driven": ALL - {"gripper"}}, "Held in part", [], None),
        (Mode.HOLDING, {"driven": ALL - {"gripper"}, "silent": frozenset({"gripper"})},
         "Idle, holding", [], None),
    ],
)  # fmt: skip
def test_the_bar_says_of_an_arm_what_its_torque_registers_say(mode, reading, title, says, let_go):
    bar, buttons = hold_buttons({"": rig(mode, **reading)})
    buttons.refresh()
    assert bar.state == title
    assert [each.text for sentences in bar._alerts.values() for each in sentences] == says
    assert {each.label: each.why_not for each in bar.buttons}["Let go"] == let_go


def test_every_tab_says_of_an_arm_that_it_is_gone_or_back_and_not_how_it_was_before():
    left, right = rig(Mode.LIMP), rig(Mode.HOLDING)
    bar, buttons = hold_buttons({"left": left, "right": right})
    tabs = []
    for connection, mode in ((LOST, Mode.LIMP), (ARM, Mode.FAULT), (ARM, Mode.HOLDING)):
        left.connection, left.arm.state = connection, state(mode)
        buttons.refresh()
        tabs.append((bar.lost and bar.lost.text, bar.state))
    assert tabs == [
        ("left: The arm is disconnected, so nothing can move.",
         "left: Arm disconnected; right: Idle, holding"),
        ("left: The arm is back. Press Hold to go on.",
         "left: Connected again; right: Idle, holding"),
        (None, "Idle, holding"),
    ]  # fmt: skip


def test_the_bar_says_of_an_arm_that_it_was_stopped_until_it_moves_again_or_lets_go():
    one = rig(Mode.MOVING)
    bar, buttons = hold_buttons({"": one})
    said = []
    for stops, mode in (
        (0, Mode.HOLDING), (0, Mode.MOVING), (1, Mode.MOVING), (1, Mode.STOPPING),
        (1, Mode.HOLDING), (1, Mode.HOLDING), (1, Mode.MOVING), (1, Mode.HOLDING),
        (2, Mode.HOLDING), (2, Mode.LIMP), (2, Mode.HOLDING),
    ):  # fmt: skip
        one.arm.stops, one.arm.state = stops, state(mode)
        buttons.refresh()
        said.append(bar.state)
    assert said == [
        "Idle, holding", "Moving", "Moving", "Stopping",
        "Stopped, holding", "Stopped, holding", "Moving", "Idle, holding",
        "Stopped, holding", "Limp", "Idle, holding",
    ]  # fmt: skip
