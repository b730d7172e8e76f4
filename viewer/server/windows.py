"""Keep track of the open browser windows and let one of them act: the one in control.

The first window has control; any other takes it with a button, and whoever lost it is told. Stop
needs no control. Each window has a line over the picture that says who has it; our front end shows
it (``front/bar.js``). viser ignores a window until it has drawn its first picture, but its buttons,
Stop among them, are there before; so here a window counts from its connection on.
"""

from __future__ import annotations

import inspect
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import viser
from viser import _messages
from viser.infra import ClientId, Message, WebsockClientConnection

from ..page.bar import board, uuid_of

_QUIET = 3.0  # a window that is refused again within this time is not notified again [s]

_TAKE = "Take control"
_HOW = "You can take control below the bar at the top."

Handler = Callable[[Any, Any], Any]

_GUI = (
    _messages.GuiUpdateMessage,
    _messages.GuiButtonHoldMessage,
    _messages.GuiFormSubmitMessage,
    _messages.GuiFormDirtyMessage,
    _messages.CommandTriggerMessage,
    _messages.FileTransferStartUpload,
)
_SCENE = (
    _messages.TransformControlsUpdateMessage,
    _messages.TransformControlsDragStartMessage,
    _messages.TransformControlsDragEndMessage,
    _messages.SceneNodeClickMessage,
    _messages.SceneNodeDragMessage,
    _messages.ScenePointerMessage,
)
"""All messages that change what the windows share."""


@dataclass(slots=True, kw_only=True)
class _Window:
    """One window and its own widgets."""

    number: int
    client: viser.ClientHandle
    board: viser.GuiHtmlHandle
    take: viser.GuiButtonHandle
    refused_at: float = -_QUIET


class Windows:
    """Lets only the window in control press, type or drag, and shows every window its state.

    viser hands every message to a list of handlers, which change the widget for all browsers. This
    stands before them: a refused message changes nothing, and its window gets the true value back.
    Messages about a window's own view and tabs pass, and those for open widgets (Stop). This uses
    viser's internals; its version is pinned and the tests press real buttons.

    ``given_up`` is called when the window in control has gone.
    """

    def __init__(
        self, server: viser.ViserServer, tell: Callable[[str], None], given_up: Callable[[], None]
    ) -> None:
        self._server, self._tell, self._given_up = server, tell, given_up
        self._lock = threading.Lock()
        self._by_client: dict[int, _Window] = {}
        self._holder: int | None = None  # the number of the window in control
        self._closing = False
        self._open, self._stops = set[str](), set[str]()
        handlers = server._websock_server._incoming_handlers
        for kind in (*_GUI, *_SCENE):
            handlers[kind] = [self._behind(handler) for handler in handlers[kind]]
        server.on_client_connect(self._came)
        server.on_client_disconnect(self._went)
        server._websock_server.on_client_connect(_count)

    def leave_open(self, *widgets: Any) -> None:
        self._open.update(widget._impl.uuid for widget in widgets)
        self._show()

    def leave_open_as_stop(self, *widgets: Any) -> None:
        """The same for buttons that stop the arm; logs which window pressed them."""
        self.leave_open(*widgets)
        self._stops.update(widget._impl.uuid for widget in widgets)

    def close(self) -> None:
        """Tell windows nothing more; the server ends."""
        self._closing = True

    def all(self) -> tuple[_Window, ...]:
        with self._lock:
            return tuple(self._by_client.values())

    # The event loop's thread

    async def _came(self, client: viser.ClientHandle) -> None:
        with self._lock:
            taken = {window.number for window in self._by_client.values()}
            number = next(n for n in range(1, len(taken) + 2) if n not in taken)
            window = self._by_client[client.client_id] = _Window(
                number=number,
                client=client,
                board=client.gui.add_html("", visible=False),
                take=client.gui.add_button(_TAKE, visible=False),
            )

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
        if window is not None and not self._closing:
            self._tell(f"Window {window.number} closed")
            if self._holder == window.number:
                self._holder = None
                self._given_up()
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
        for window in self.all():
            controls = self._holder in (None, window.number)
            press = {"label": _TAKE, "press": uuid_of(window.take), "value": True}
            window.board.content = board(
                "window",
                text=words(window.number, self._holder),
                controls=controls,
                open=sorted(self._open),
                buttons=[] if controls else [press],
            )

    # Messages

    def _behind(self, handler: Handler) -> Handler:
        async def guarded(client_id: Any, message: Message) -> None:
            window = self._by_client.get(int(client_id))
            if self._is_shared(message) and not self._may_act(window):
                self._put_right(int(client_id), message)
                return
            if window is not None and getattr(message, "uuid", None) in self._stops:
                self._tell(f"Stop pressed in window {window.number}")
            outcome = handler(client_id, message)
            if inspect.isawaitable(outcome):
                await outcome

        return guarded

    def _may_act(self, window: _Window | None) -> bool:
        """Whether it has control, or takes it because no window has; another is told."""
        if window is None:
            return False
        if self._holder is None:
            self._give(window.number)
        now = time.monotonic()
        if self._holder != window.number and now - window.refused_at >= _QUIET:
            window.refused_at = now
            who = f"Window {self._holder} has control"
            _notify(window, who, f"Nothing was changed. {_HOW}", 4.0)
        return self._holder == window.number

    def _is_shared(self, message: Any) -> bool:
        """Whether ``message`` concerns something that all windows share."""
        if isinstance(message, _SCENE):
            return bool(getattr(message, "owner", None) in (None, self._server.scene._owner_id))
        uuid = getattr(message, "source_component_uuid", None) or message.uuid
        gui = self._server.gui
        known = (
            gui._gui_input_handle_from_uuid,
            gui._container_handle_from_uuid,
            gui._command_handle_from_uuid,
        )
        return uuid not in self._open and any(uuid in handles for handles in known)

    def _put_right(self, client_id: int, message: Any) -> None:
        client = self._server.get_clients().get(client_id)
        if client is None:
            return
        if isinstance(message, _messages.GuiUpdateMessage):
            handle = self._server.gui._gui_input_handle_from_uuid.get(message.uuid)
            if handle is not None and not handle._impl.is_button:
                back = _messages.GuiUpdateMessage(message.uuid, {"value": handle._impl.value})
                client._websock_connection.queue_message(back)
        elif isinstance(message, _messages.TransformControlsUpdateMessage):
            node = self._server.scene._handle_from_node_name.get(message.name)
            if node is not None:
                for put in _placement(message.name, node, self._server.scene._owner_id):
                    client._websock_connection.queue_message(put)


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


def words(number: int, holder: int | None) -> str | None:
    if holder is None:
        return "No window has control. Press any button to take it."
    return None if holder == number else f"Window {holder} has control. Stop works here too."


def _notify(window: _Window, title: str, body: str, seconds: float) -> None:
    window.client.add_notification(title, body, color="orange", auto_close_seconds=seconds)


def _placement(name: str, node: Any, owner: Any) -> tuple[Message, Message]:
    w, x, y, z = map(float, node.wxyz)
    orientation = _messages.SetOrientationMessage(name, (w, x, y, z))
    x, y, z = map(float, node.position)
    position = _messages.SetPositionMessage(name, (x, y, z))
    for message in (orientation, position):
        message.owner = owner
    return orientation, position
