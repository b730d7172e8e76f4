"""The desk every part of the page works at: the arm, the page, and how a press becomes a command.

A part (``Part``) owns some widgets and what they mean. viser calls handlers from threads of its
own; nothing is done there. A handler made here puts a command into the queue, and the page's one
thread runs it, so parts need no locks. Stop alone does not come this way. Of several browser
windows only the one in control gets as far as a handler; see ``turnstile.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import viser

from so101_motion.rig_like import RigLike

from .commands import Command
from .events import EventLog

T = TypeVar("T")


class Part(Protocol):
    """One thing the page can do. All of it is called from the page's thread."""

    def refresh(self) -> bool:
        """Take note of what happened since the last call; whether there is news to show."""
        ...

    def show(self) -> None:
        """Bring the widgets and the picture up to date; viser sends only what differs."""
        ...

    def close(self) -> None:
        """The page is going: let go of what is not the page's own."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Counter:
    """What a part needs that has no arm, or not yet.

    Attributes:
        server: The page.
        tabs: The tabs of the panel on the right, one a part.
        post: Brings a command to the page's thread.
        workers: Runs what takes a while, one after the other.
        leave_open: Lets every window press the widgets it is given; all others are for the window
            in control.
        events: What happened, for people.
    """

    server: viser.ViserServer
    tabs: viser.GuiTabGroupHandle
    post: Callable[[Command], None]
    workers: ThreadPoolExecutor
    leave_open: Callable[..., None] = lambda *_: None
    events: EventLog = field(default_factory=EventLog)

    @property
    def gui(self) -> viser.GuiApi:
        """Where widgets are made."""
        return self.server.gui

    def beside(self, call: Callable[[], T]) -> Future[T]:
        """Run ``call`` beside the page."""
        return self.workers.submit(call)

    def on_press(self, button: Any, command: Command) -> None:
        """Run ``command`` when ``button`` (or a key's command) is pressed."""

        async def handler(_event: object) -> None:
            self.post(command)

        attach = button.on_trigger if hasattr(button, "on_trigger") else button.on_click
        attach(handler)

    def on_choice(self, group: Any, command: Callable[[str], None]) -> None:
        """Run ``command`` with the name on the button of ``group`` that is pressed."""

        async def handler(event: viser.GuiEvent[Any]) -> None:
            name = event.target.value
            self.post(lambda: command(name))

        group.on_click(handler)

    def on_entry(self, widget: Any, command: Callable[[Any], None]) -> None:
        """Run ``command`` with the value that somebody, not the page, gave ``widget``."""

        async def handler(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is not None:
                value = event.target.value
                self.post(lambda: command(value))

        widget.on_update(handler)

    def on_drag(
        self,
        handle: viser.TransformControlsHandle,
        command: Callable[[viser.TransformControlsHandle], None],
    ) -> None:
        """Run ``command`` with ``handle`` when somebody drags it."""

        async def handler(_event: viser.TransformControlsEvent) -> None:
            self.post(lambda: command(handle))

        handle.on_update(handler)

    def on_release(
        self,
        handle: viser.TransformControlsHandle,
        command: Callable[[viser.TransformControlsHandle], None],
    ) -> None:
        """Run ``command`` with ``handle`` when somebody who dragged it lets go."""

        async def handler(event: viser.TransformControlsEvent) -> None:
            if event.phase == "end":
                self.post(lambda: command(handle))

        handle.on_update(handler)

    def on_pick(self, node: Any, command: Command) -> None:
        """Run ``command`` when somebody clicks on ``node`` of the scene."""

        async def handler(_event: object) -> None:
            self.post(command)

        node.on_click(handler)

    def on_file(
        self, button: viser.GuiUploadButtonHandle, command: Callable[[viser.UploadedFile], None]
    ) -> None:
        """Run ``command`` with a file that somebody hands over by ``button``."""

        async def handler(event: viser.GuiEvent[Any]) -> None:
            file = event.target.value
            self.post(lambda: command(file))

        button.on_upload(handler)

    def on_asked(self, button: Any, answer: Callable[[viser.ClientHandle], None]) -> None:
        """Run ``answer`` with the browser that pressed ``button``.

        For what a browser takes away, such as a download; it changes nothing here.
        """

        async def handler(event: viser.GuiEvent[Any]) -> None:
            client = event.client
            if client is not None:
                self.post(lambda: answer(client))

        button.on_click(handler)


@dataclass(frozen=True, slots=True, kw_only=True)
class Desk(Counter):
    """What a part needs.

    Attributes:
        rig: The arm and the gripper; not ours to close.
    """

    rig: RigLike
