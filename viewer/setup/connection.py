"""The page to choose the port, with the problems of each port.

While the page is shown, all ports are looked at again and again, so a cable that is plugged in, a
supply that is switched on or a program that has ended shows by itself.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import viser

from so101_motion.setup.checkup import Check, fail
from so101_motion.setup.port_selection import Candidate, PortsSeen
from so101_motion.setup.setup_steps import CONNECT

from ..page import cards
from . import setup_cards
from .page import StepPage
from .setup_context import SetupContext
from .setup_target import Ports, SetupTarget

PERIOD = 1.0
"""How long to wait between two looks [s]; chosen: soon enough for somebody who plugs a cable in."""

_BARE = (
    "With a new kit this is fine: its motors are connected later, one at a time. With an assembled"
    " arm, first do what is said above."
)

_MOST_PORTS = 6  # to choose from; chosen: nobody has more arms on one computer


class PortWatch:
    """Looks at the ports again and again in its own thread.

    Args:
        look: Looks at them; takes up to two seconds.
    """

    def __init__(self, look: Callable[[], PortsSeen]) -> None:
        self._look = look
        self._ends: threading.Event | None = None
        self._thread: threading.Thread | None = None
        self.seen: PortsSeen | None = None

    def begin(self) -> None:
        """Start looking."""
        if self._ends is None:
            self._ends = threading.Event()
            self._thread = threading.Thread(
                target=self._run, args=(self._ends,), name="so101-setup-ports", daemon=True
            )
            self._thread.start()

    def end(self) -> None:
        """Stop looking; returns when no port is open."""
        if self._ends is not None and self._thread is not None:
            self._ends.set()
            self._thread.join()
            self._ends = self._thread = None

    def _run(self, ends: threading.Event) -> None:
        while not ends.is_set():
            began = time.monotonic()
            self.seen = self._look()
            ends.wait(max(PERIOD - (time.monotonic() - began), 0.2))


class PortChoice:
    """The choice of the port.

    Attributes:
        seen: What was plugged in at the last look; None before the first.
        picked: The port that a person has picked, by name; None while nobody has.
    """

    def __init__(self) -> None:
        self.seen: PortsSeen | None = None
        self.picked: str | None = None

    @property
    def chosen(self) -> Candidate | None:
        """The picked port, else the only one that can be used, or the only one there."""
        if self.seen is None:
            return None
        candidates = self.seen.candidates
        picked = [candidate for candidate in candidates if candidate.name == self.picked]
        if picked:
            return picked[0]
        usable = self.seen.usable
        if len(usable) == 1:
            return usable[0]
        return candidates[0] if len(candidates) == 1 else None

    @property
    def check(self) -> Check | None:
        """What is wrong with the choice itself; None if the chosen port alone decides."""
        if self.seen is None:
            return Check(name="connect", verdict="fail", sentence="looking at the ports")
        if self.chosen is None and len(self.seen.candidates) > 1:
            return fail(
                "connect",
                f"there are {len(self.seen.candidates)} ports",
                "choose the port of the arm to set up",
            )
        return None


class ConnectionPage(StepPage):
    """The page of the connection step.

    Args:
        setup: What all pages share.
    """

    def __init__(self, setup: SetupContext, ports: Ports) -> None:
        super().__init__(setup, CONNECT)
        self._ports = ports
        self._port_watch = PortWatch(ports.look)
        self.model = PortChoice()

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        gui.add_html(cards.instruction(CONNECT.title, CONNECT.instruction))
        self._cards = [gui.add_html("", visible=False) for _ in range(_MOST_PORTS)]
        self._picks = [gui.add_button("", visible=False, color="gray") for _ in range(_MOST_PORTS)]
        for place, button in enumerate(self._picks):
            self._setup.context.on_press(button, partial(self._pick, place))
        self._name = gui.add_text(
            "Name of this arm",
            self._setup.progress.arm,
            hint="Such as leader or follower; its calibration gets a file of that name",
            visible=False,
        )
        self._setup.context.on_entry(self._name, self._setup.progress.call)
        self._status = gui.add_html("")

    def enter(self) -> None:
        """Start looking at the ports."""
        self._setup.make = self._open
        if self._setup.fixed is None and self._setup.target is None:
            self._port_watch.begin()

    def leave(self) -> None:
        """Stop looking; the port may be opened for good now."""
        self._port_watch.end()

    def refresh(self) -> bool:
        """Take in the last look."""
        fixed, before = self._setup.fixed, self._setup.seen
        if fixed is not None:
            self._setup.seen = replace(fixed.findings(), servos=before.servos)
            return self._setup.seen != before
        if self._port_watch.seen is self.model.seen:
            return False
        self.model.seen = self._port_watch.seen
        self._judge()
        return True

    def show(self) -> None:
        """Show the ports."""
        seen = self.model.seen
        candidates = seen.candidates[:_MOST_PORTS] if seen is not None else ()
        chosen, many = self.model.chosen, len(candidates) > 1
        for place in range(_MOST_PORTS):
            there = place < len(candidates)
            self._cards[place].visible = there
            self._picks[place].visible = there and many and candidates[place] is not chosen
            if there:
                candidate = candidates[place]
                self._cards[place].content = setup_cards.port(
                    candidate, is_chosen=candidate is chosen
                )
                self._picks[place].label = f"Use {candidate.name}"
        self._name.visible = chosen is not None and chosen.report.calibration is None
        is_bare = chosen is not None and not chosen.report.servo_ids
        self._status.content = setup_cards.check_text(self.check()) + cards.note(
            _BARE if is_bare else ""
        )

    def check(self) -> Check:
        """Whether there is a usable port."""
        return self._of_several() or super().check()

    def _as_it_was(self) -> str:
        return "nothing was changed"

    # Helpers

    def _of_several(self) -> Check | None:
        is_settled = self._setup.fixed is not None or self._setup.target is not None
        return None if is_settled else self.model.check

    def _judge(self) -> None:
        seen, chosen = self.model.seen, self.model.chosen
        if seen is not None:
            self._setup.seen = seen.nothing if chosen is None else chosen.findings

    def _pick(self, place: int) -> None:
        if self.model.seen is not None and place < len(self.model.seen.candidates):
            self.model.picked = self.model.seen.candidates[place].name
            self._judge()

    def _open(self) -> SetupTarget:
        """Open the target on the chosen port; in a worker's thread."""
        if self._setup.fixed is not None:
            return self._setup.fixed.open()
        chosen = self.model.chosen
        assert chosen is not None  # else one could not have gone on
        self._port_watch.end()
        has_file = chosen.report.calibration is not None
        return self._ports.open(chosen, "" if has_file else self._setup.progress.arm)
