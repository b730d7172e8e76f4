"""Keep track of the open browser windows and let one of them act: the one in control.

The first window has control; any other takes it with a button, and whoever lost it is told. Stop
needs no control. Each window has a line over the picture that says who has it; our front end shows
it (``front/bar.js``). viser ignores a window until it has drawn its first picture, but its buttons,
Stop among them, are there before; so here a window counts from its connection on.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import viser
from viser import _messages
from viser.infra import ClientId, WebsockClientConnection

from ..page.bar import board, uuid_of
from .control_filter import ControlFilter

_QUIET = 3.0
"""A window that is refused again within this time is not notified again [s]."""

_TAKE = "Take control"
_HOW = "You can take control below the bar at the top."


@dataclass(slots=True, kw_only=True)
class _Window:
    """One window and its own widgets."""

    number: int
    client: viser.ClientHandle
    board: viser.GuiHtmlHandle
    take: viser.GuiButtonHandle
    refused_at: float = -_QUIET


class Windows:
    """Lets the window in control act, and shows every window its state."""

    def __init__(self, server: viser.ViserServer, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._lock = threading.Lock()
        self._by_client: dict[int, _Window] = {}
        self._holder: int | None = None  # the number of the window in control
        self._filter = ControlFilter(
            server, may_act=self._may_act, refused=self._refused, passed=self._passed
        )
        self._stops: set[str] = set()
        server.on_client_connect(self._came)
        server.on_client_disconnect(self._went)
        server._websock_server.on_client_connect(_count)

    def leave_open(self, *widgets: Any) -> None:
        """Let every window press ``widgets``."""
        self._filter.leave_open(*widgets)

    def leave_open_as_stop(self, *widgets: Any) -> None:
        """The same for buttons that stop the arm; logs which window pressed them."""
        self.leave_open(*widgets)
        self._stops.update(widget._impl.uuid for widget in widgets)

    def all(self) -> tuple[_Window, ...]:
        """All open windows with their widgets, the oldest first."""
        with self._lock:
            return tuple(self._by_client.values())

    # The event loop's thread

    async def _came(self, client: viser.ClientHandle) -> None:
        with self._lock:
            taken = {window.number for window in self._by_client.values()}
            number = next(n for n in range(1, len(taken) + 2) if n not in taken)
            window = _made_for(client, number)
            self._by_client[client.client_id] = window

            async def take(_event: object) -> None:
                self._give(number)

            window.take.on_click(take)
        self._tell(f"Window {number} opened")
        if self._holder is None:
            self._give(number)
        self._show()

    async def _went(self, client: viser.ClientHandle) -> None:
        with self._lock:
            window = self._by_client.pop(client.client_id, None)
        if window is not None:
            self._tell(f"Window {window.number} closed")
            if self._holder == window.number:
                self._holder = None
            self._show()

    def _give(self, number: int) -> None:
        before, self._holder = self._holder, number
        for window in self.all():
            if window.number == before != number:
                _notify(window, f"Window {number} has taken control", _HOW, 4.0)
        if len(self._by_client) > 1 and before != number:
            self._tell(f"Window {number} has control")
        self._show()

    def _show(self) -> None:
        """Tell every window who has control."""
        for window in self.all():
            controls = self._holder in (None, window.number)
            press = {"label": _TAKE, "press": uuid_of(window.take), "value": True}
            window.board.content = board(
                "window",
                text=words(window.number, self._holder),
                controls=controls,
                buttons=[] if controls else [press],
            )

    def _may_act(self, client_id: int) -> bool:
        window = self._by_client.get(client_id)
        if window is not None and self._holder is None:
            self._give(window.number)
        return window is not None and self._holder == window.number

    def _passed(self, client_id: int, uuid: str) -> None:
        window = self._by_client.get(client_id)
        if uuid in self._stops and window is not None:
            self._tell(f"Stop pressed in window {window.number}")

    def _refused(self, client_id: int) -> None:
        window = self._by_client.get(client_id)
        now = time.monotonic()
        if window is None or now - window.refused_at < _QUIET:
            return
        window.refused_at = now
        _notify(window, f"Window {self._holder} has control", f"Nothing was changed. {_HOW}", 4.0)


async def _count(connection: WebsockClientConnection) -> None:
    """Make viser count the window as connected, which it does when the camera's pose arrives."""
    camera = _messages.ViewerCameraMessage(
        wxyz=(1.0, 0.0, 0.0, 0.0),
        position=(1.0, 1.0, 1.0),
        fov=1.0,
        near=0.01,
        far=1000.0,
        image_height=1,
        image_width=1,
        look_at=(0.0, 0.0, 0.0),
        up_direction=(0.0, 0.0, 1.0),
    )  # any pose will do: the window sends its own with each picture
    await connection._handle_incoming_message(ClientId(connection.client_id), camera)


def _made_for(client: viser.ClientHandle, number: int) -> _Window:
    gui = client.gui
    return _Window(
        number=number,
        client=client,
        board=gui.add_html("", visible=False),
        take=gui.add_button(_TAKE, visible=False),
    )


def words(number: int, holder: int | None) -> str | None:
    """The line of a window; None when it simply has control."""
    if holder is None:
        return "No window has control. Press any button to take it."
    return None if holder == number else f"Window {holder} has control. Stop works here too."


def _notify(window: _Window, title: str, body: str, seconds: float) -> None:
    window.client.add_notification(title, body, color="orange", auto_close_seconds=seconds)
