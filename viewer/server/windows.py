"""Keep track of the open browser windows and tell each whether it is in control.

When control is shared or asked for, each window has a line over the picture with buttons to ask or
to answer; our front end shows it (``front/bar.js``). viser ignores a window until it has drawn its
first picture, but its buttons, Stop among them, are there before; so here a window counts from its
connection on.
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
from .control import PATIENCE, Role, WindowControl, WindowStatus
from .control_filter import ControlFilter

_QUIET = 3.0
"""A window that is refused again within this time is not notified again [s]."""

_ASK, _LET_GO, _KEEP = "Ask for control", "Hand over", "Keep"


@dataclass(slots=True, kw_only=True)
class _Window:
    """One window and its own widgets."""

    number: int
    client: viser.ClientHandle
    board: viser.GuiHtmlHandle
    ask: viser.GuiButtonHandle
    answer: viser.GuiButtonGroupHandle
    shown: WindowStatus | None = None
    refused_at: float = -_QUIET


class Windows:
    """Lets the window in control act, and shows every window its state."""

    def __init__(self, server: viser.ViserServer, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._lock = threading.Lock()
        self._by_client: dict[int, _Window] = {}
        self._control = WindowControl(time.monotonic, tell)
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

    def refresh(self) -> None:
        """Update each window's line; called now and then by the page's thread."""
        self._control.tick()
        for window in self.all():
            standing = self._control.status(window.number)
            if standing != window.shown:
                was = window.shown.role if window.shown is not None else None
                window.shown = standing
                _show(window, standing)
                if standing.role is Role.ASKED and was is not Role.ASKED:
                    asking = f"Window {standing.other} asks for control"
                    _notify(window, asking, "Answer below the bar at the top.", PATIENCE)

    # The event loop's thread

    async def _came(self, client: viser.ClientHandle) -> None:
        with self._lock:
            taken = {window.number for window in self._by_client.values()}
            number = next(n for n in range(1, len(taken) + 2) if n not in taken)
            window = _made_for(client, number)
            self._by_client[client.client_id] = window

            async def ask(_event: object) -> None:
                self._control.ask(number)

            async def answer(event: viser.GuiEvent[Any]) -> None:
                self._control.answer(number, allow=event.target.value == _LET_GO)

            window.ask.on_click(ask)
            window.answer.on_click(answer)
        self._tell(f"Window {number} opened")
        self._control.join(number)

    async def _went(self, client: viser.ClientHandle) -> None:
        with self._lock:
            window = self._by_client.pop(client.client_id, None)
        if window is not None:
            self._tell(f"Window {window.number} closed")
            self._control.leave(window.number)

    def _may_act(self, client_id: int) -> bool:
        window = self._by_client.get(client_id)
        return window is not None and self._control.may_act(window.number)

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
        other = self._control.status(window.number).other
        _notify(
            window,
            f"Window {other} has control",
            "Nothing was changed. You can ask for control below the bar at the top.",
            4.0,
        )


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
        ask=gui.add_button(_ASK, visible=False),
        answer=gui.add_button_group("Control", (_LET_GO, _KEEP), visible=False),
    )


def _show(window: _Window, standing: WindowStatus) -> None:
    buttons: list[dict[str, Any]] = []
    if standing.role is Role.WATCHING:
        buttons = [{"label": _ASK, "press": uuid_of(window.ask), "value": True}]
    elif standing.role is Role.ASKED:
        answer = uuid_of(window.answer)
        buttons = [{"label": word, "press": answer, "value": word} for word in (_LET_GO, _KEEP)]
    controls = standing.role not in (Role.WATCHING, Role.ASKING)
    window.board.content = board("window", text=words(standing), controls=controls, buttons=buttons)


def words(standing: WindowStatus) -> str | None:
    """The line of a window; None when it simply has control."""
    other, seconds = standing.other, standing.seconds
    return {
        Role.IN_CONTROL: None,
        Role.WATCHING: f"Window {other} has control. Stop works here too.",
        Role.ASKING: f"Asked window {other}. You get control in {seconds} s unless it refuses.",
        Role.ASKED: f"Window {other} will get control in {seconds} s.",
        Role.FREE: "No window has control. Press any button to take it.",
    }[standing.role]


def _notify(window: _Window, title: str, body: str, seconds: float) -> None:
    window.client.add_notification(title, body, color="orange", auto_close_seconds=seconds)
