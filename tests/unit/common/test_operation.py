"""One toy operation on all four surfaces: nothing but the operation itself is written for it."""

import asyncio
import contextlib
import json
import os
import pty
import threading
import time

import pytest
from harness.page_client import Hand
from so101_viewer.page.operation_panel import OperationPanel
from so101_viewer.server.guarded_server import start_guarded
from so101_viewer.server.host import ServedPage

from so101_motion.arm.stop_order import NUMBERS, is_older
from so101_motion.cli.operation_terminal import OperationTerminal
from so101_motion.cli.terminal import Quit, Terminal
from so101_motion.common.errors import ConfigError, MachineRefused, So101Error
from so101_motion.common.operation import LocalOperation, Offer, RemoteOperation, Row, View
from so101_motion.viam.conversion.convert import to_result
from so101_motion.viam.requests.commands import answer
from so101_motion.viam.requests.operation_commands import operation_commands


class Kettle(LocalOperation):
    """Fills a kettle in portions and boils it."""

    def __init__(self):
        super().__init__()
        self.litres, self.state = 0.0, "filling"
        self.commands = {"fill": self.fill, "boil": self.boil, "empty": self.empty}

    @property
    def view(self):
        left = "it is not full; fill it" if self.litres < 1.0 else None
        return View(
            state=self.state,
            title="Tea",
            text="Fill the kettle" if left else "Boil it",
            rows=(Row(label="water", cells=(f"{self.litres:.1f} l",), bar=(0.0, self.litres)),),
            offers=(
                Offer(command="fill", title="Fill", key="f", arguments={"litres": 0.5}),
                Offer(command="boil", title="Boil", key="b", why_not=left),
                Offer(command="empty", title="Pour it away", cancels=True),
            ),
            said=self.said,
            is_over=self.state == "done",
        )

    def fill(self, litres: float):
        if self.litres + litres > 1.0:
            raise ConfigError("litres", litres, "it would overflow")
        self.litres += litres
        return {"litres": self.litres}

    def boil(self):
        self.state = "done"
        self.can_be_stopped = is_older(next(NUMBERS))
        self.say("the tea is ready", "good")

    def empty(self):
        self.litres = 0.0
        self.say("the kettle is empty again")


def over_the_wire(commands):
    """Sends requests to DoCommand handlers as a Viam client does: numbers become floats."""

    def send(request):
        sent = json.loads(json.dumps(request), parse_int=float)
        try:
            found = to_result(asyncio.run(answer(sent, commands)))
        except So101Error as error:
            raise MachineRefused("kettle", "", str(error)) from error
        return json.loads(json.dumps(found), parse_int=float)

    return send


@pytest.fixture
def kettle():
    return Kettle()


@pytest.fixture
def send(kettle):
    keys = {"pour": ("kettle", "fill"), "boil": ("kettle", "boil")}
    return over_the_wire(operation_commands({"kettle": kettle}, keys, beside={"success": True}))


def test_commands_are_docommands_under_their_published_keys(kettle, send):
    assert send({"command": "pour", "litres": 0.5}) == {"success": True, "litres": 0.5}
    with pytest.raises(MachineRefused, match="boil: it is not full; fill it"):
        send({"command": "boil"})
    with pytest.raises(MachineRefused, match="is missing"):
        send({"command": "pour"})
    with pytest.raises(MachineRefused, match="unknown argument"):
        send({"command": "pour", "liters": 1.0})
    kettle.litres = 1.0
    assert send({"command": "boil"}) == {"success": True}


def test_a_remote_operation_is_used_like_the_local_one(kettle, send):
    with contextlib.closing(RemoteOperation(send, "kettle")) as remote:
        assert remote.view == kettle.view
        assert remote.ask("fill", litres=0.5) == {"litres": 0.5}
        assert remote.view == kettle.view
        with pytest.raises(MachineRefused, match="it would overflow"):
            remote.ask("fill", litres=2.0)
        with pytest.raises(MachineRefused, match='did you mean "boil"'):
            remote.ask("boill")
    with pytest.raises(MachineRefused, match='did you mean "kettle"'):
        RemoteOperation(send, "kettel")


def test_the_last_view_stays_when_the_machine_does_not_answer(kettle, send):
    with contextlib.closing(RemoteOperation(lambda request: send(request), "kettle")) as remote:
        remote._send = lambda _: (_ for _ in ()).throw(MachineRefused("kettle", "", "gone"))
        with pytest.raises(MachineRefused):
            remote.ask("fill", litres=0.5)
        assert not remote.view.is_connected
        assert "gone" in remote.view.trouble
        assert remote.view.rows == kettle.view.rows


@pytest.mark.parametrize("is_remote", [False, True])
def test_it_is_led_through_in_a_terminal(kettle, send, is_remote, monkeypatch):
    operation = RemoteOperation(send, "kettle") if is_remote else kettle
    person, program = pty.openpty()
    seen = bytearray()

    def read():
        with contextlib.suppress(OSError):
            while piece := os.read(person, 4096):
                seen.extend(piece)

    def sees(words):
        ends = time.monotonic() + 60.0
        while words not in seen:
            assert time.monotonic() < ends, (words, bytes(seen[-2000:]))
            time.sleep(0.01)

    def types():
        shown = (
            b"Fill the kettle", b'"z" does nothing here; the keys are f, b, q',
            b"Boil: it is not full", b"0.5 l", b"Boil it", b"overflow",
        )  # fmt: skip
        for words, key in zip(shown, (b"z", b"b", b"f", b"f", b"f", b"b"), strict=True):
            sees(words)
            os.write(person, key)

    with (
        os.fdopen(os.dup(program), "r", encoding="utf-8") as stream,
        os.fdopen(program, "w", encoding="utf-8") as output,
    ):
        monkeypatch.setattr("sys.stdin", stream)
        monkeypatch.setattr("sys.stderr", output)
        monkeypatch.setenv("TERM", "xterm")
        for work in (read, types):
            threading.Thread(target=work, daemon=True).start()
        with Terminal() as terminal:
            assert OperationTerminal(operation, terminal).go().state == "done"
        sees(b"the tea is ready")
        kettle.state = "filling"
        while operation.view.is_over:
            time.sleep(0.01)
        over = threading.Event()

        def quits():
            while not over.wait(0.2):  # what is typed before the terminal listens is lost
                os.write(person, b"q")

        threading.Thread(target=quits, daemon=True).start()
        with Terminal() as terminal:
            walk = OperationTerminal(operation, terminal)
            with pytest.raises(Quit):
                walk.go()
            over.set()
            terminal.say(walk.give_up())
        assert kettle.litres == 0.0
        sees(b"the kettle is empty again")
    operation.close()


@pytest.mark.parametrize("is_remote", [False, True])
def test_it_is_a_panel_of_the_page(kettle, send, is_remote):
    operation = RemoteOperation(send, "kettle") if is_remote else kettle
    host = ServedPage(start_guarded("127.0.0.1", 0, allow_remote=False, label="toy"))
    context = host.page_context()
    panel = OperationPanel(context, lambda: operation)
    with context.tabs.add_tab("Tea"):
        panel.build(context.gui)
    host.add_parts(panel)
    host.start()
    try:
        hand = Hand(host)
        hand.expect("Fill the kettle")
        assert not hand.can("Boil")
        hand.press("Pour it away")
        hand.expect("the kettle is empty again")
        hand.press("Fill")
        hand.expect("0.5 l")
        hand.press("Fill")
        hand.expect("Boil it")
        hand.press("Fill")
        hand.expect("it would overflow")
        hand.press("Boil")
        hand.expect("the tea is ready")
        kettle.state = "filling"
        hand.until(lambda: not hand.says("the tea is ready"), "another state")
        assert kettle.can_be_stopped, "a stop that comes after the press ends what it begins"
    finally:
        host.close()
        operation.close()
