"""Connect a part of the page to its server, and queue its events as commands for the page's thread.

viser calls handlers from threads of its own. Those made here only queue a command, so parts need no
locks. Only Stop bypasses the queue; only the window in control reaches a handler.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from functools import partial
from typing import Any, Self, TypeVar

import viser

from so101_motion.common.errors import So101Error

from . import markup
from .bar import Bar
from .events import EventLog
from .screen_state import Sentence

T = TypeVar("T")

Command = Callable[[], None]

PICK = "Pick"
PROGRAM = "Program"  # the tab that has a plan of its own, besides the Move tab


class Drawn(Enum):
    """What the scene shows of the Move tab."""

    PLAN = auto()
    """The plan: its path, and a ghost that goes along it."""
    TARGET = auto()
    """A ghost at the target, to be recorded as a step of a program; no path."""
    NOTHING = auto()
    """No ghost, no path: the program's are shown instead."""


@dataclass(slots=True)
class FrontTab:
    """The tab in front in the window in control, and whether its program has the ghost."""

    name: str = ""
    rehearses: bool = False
    _rehearsed: tuple[object, ...] = field(default=(), repr=False)
    _targets: tuple[object, ...] = field(default=(), repr=False)
    _seen: tuple[object, ...] = field(default=(), repr=False)

    def note(
        self, rehearsal: object | None, t: float, targets: tuple[object, ...], *, runs: bool
    ) -> bool:
        """Give the ghost to the rehearsal at ``t`` [s] or to the targets, whichever changed last.

        To the targets where both changed since the last look; a rehearsal that plays changes
        again. Return whether it changed hands.
        """
        seen, self._seen = self._seen, targets
        if (rehearsal, t) != self._rehearsed:
            self._rehearsed, self._targets = (rehearsal, t), seen or targets
        are_old = all(one is other for one, other in zip(targets, self._targets, strict=True))
        before, self.rehearses = self.rehearses, runs or (rehearsal is not None and are_old)
        return self.rehearses is not before

    @property
    def is_program(self) -> bool:
        return self.name == PROGRAM

    @property
    def drawn(self) -> Drawn:
        if not self.is_program:  # picking draws its own
            return Drawn.NOTHING if self.name == PICK else Drawn.PLAN
        return Drawn.NOTHING if self.rehearses else Drawn.TARGET


class Part:
    """A part of the page: its widgets and their commands. Runs on the page's thread."""

    def refresh(self) -> bool:
        """Take in changes since the last call; return whether there is anything new to show."""
        return False

    def show(self) -> None:
        """Update widgets and scene; viser sends only what differs."""

    def left(self) -> None:
        """End what only somebody at a window may go on with; the one in control has gone."""

    def close(self) -> None:
        """Release what does not belong to the page."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PageContext:
    """What parts of the page have in common."""

    server: viser.ViserServer
    tabs: viser.GuiTabGroupHandle
    post: Callable[[Command], None]  # queues a command for the page's thread
    workers: ThreadPoolExecutor  # runs slow calls, one after the other
    # lets every window press the given widgets, not only the one in control
    leave_open: Callable[..., None] = lambda *_: None
    events: EventLog = field(default_factory=EventLog)
    bar: Bar = field(default_factory=Bar)
    front: FrontTab = field(default_factory=FrontTab)

    @property
    def gui(self) -> viser.GuiApi:
        return self.server.gui

    def sentence(self, said: Sentence) -> str:
        """HTML of a tab's sentence about an arm, or of that an arm is lost."""
        return markup.sentence(self.bar.lost or said)

    def in_background(self, call: Callable[[], T]) -> Future[T]:
        return self.workers.submit(call)

    def handler(self, command_for: Callable[[Any], Command | None]) -> Callable[[Any], Any]:
        """A handler for viser's threads: it posts the event's command, if there is one."""

        async def handler(event: Any) -> None:
            command = command_for(event)
            if command is not None:
                self.post(command)

        return handler

    def reporting(self, report: Callable[[So101Error], None]) -> Self:
        """The same context, with refused commands passed to ``report``."""

        def post(command: Command) -> None:
            def run() -> None:
                try:
                    command()
                except So101Error as error:
                    report(error)

            self.post(run)

        return replace(self, post=post)

    def on_press(self, button: Any, command: Command) -> None:
        """Run ``command`` when a button is pressed, or a node of the scene clicked."""
        button.on_click(self.handler(lambda _event: command))

    def button(self, label: str, command: Command, **look: Any) -> viser.GuiButtonHandle:
        button = self.gui.add_button(label, **look)
        self.on_press(button, command)
        return button

    def buttons(
        self, label: str, does: Mapping[str, Command], hint: str | None = None
    ) -> viser.GuiButtonGroupHandle:
        group = self.gui.add_button_group(label, tuple(does), hint=hint)
        self.on_choice(group, lambda name: does[name]())
        return group

    def on_choice(self, group: Any, command: Callable[[str], None]) -> None:
        group.on_click(self.handler(lambda event: partial(command, event.target.value)))

    def on_entry(self, widget: Any, command: Callable[[Any], None]) -> None:
        """Run ``command`` with the value that a person, not the page, gave ``widget``."""

        def entered(event: Any) -> Command | None:
            return None if event.client_id is None else partial(command, event.target.value)

        widget.on_update(self.handler(entered))

    def on_drag(
        self,
        handle: viser.TransformControlsHandle,
        command: Callable[[viser.TransformControlsHandle], None],
        released: Command,
    ) -> None:
        """Run ``command`` with ``handle`` while it is dragged, and ``released`` when that ends."""
        handle.on_update(self.handler(lambda _event: partial(command, handle)))
        handle.on_update(self.handler(lambda event: released if event.phase == "end" else None))

    def on_asked(self, button: Any, answer: Callable[[viser.ClientHandle], None]) -> None:
        """Run ``answer`` with the browser that pressed ``button``, such as for a download."""

        def asked(event: Any) -> Command | None:
            return None if event.client is None else partial(answer, event.client)

        button.on_click(self.handler(asked))
