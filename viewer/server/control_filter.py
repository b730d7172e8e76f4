"""Let only the window in control press, type or drag.

viser hands every message to a list of handlers, which change the widget for all browsers. The
filter stands before them: a refused message changes nothing, and the window that sent it gets the
true value back. Messages about the window's own view and tabs pass, and those for open widgets
(Stop). This uses viser's internals; its version is pinned and the tests press real buttons from a
second window.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import viser
from viser import _messages
from viser.infra import Message

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


class ControlFilter:
    """Filters every message that acts.

    Args:
        server: Whose messages are filtered.
        may_act: Whether a window, by its client id, may act now.
        refused: Called with the id of a window whose message was refused.
        passed: Called with the ids of a window and of the open widget that it pressed.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        *,
        may_act: Callable[[int], bool],
        refused: Callable[[int], None],
        passed: Callable[[int, str], None],
    ) -> None:
        self._server = server
        self._may_act, self._refused, self._passed = may_act, refused, passed
        self._open: set[str] = set()
        handlers = server._websock_server._incoming_handlers
        for kind in (*_GUI, *_SCENE):
            handlers[kind] = [self._behind(handler) for handler in handlers[kind]]

    def leave_open(self, *widgets: Any) -> None:
        """Let every window press ``widgets``: buttons, and the commands of keys."""
        self._open.update(widget._impl.uuid for widget in widgets)

    def _behind(self, handler: Handler) -> Handler:
        async def guarded(client_id: Any, message: Message) -> None:
            if self._is_shared(message) and not self._may_act(int(client_id)):
                self._refused(int(client_id))
                self._put_right(int(client_id), message)
                return
            uuid = getattr(message, "uuid", None)
            if uuid in self._open:
                self._passed(int(client_id), uuid)
            outcome = handler(client_id, message)
            if inspect.isawaitable(outcome):
                await outcome

        return guarded

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
        """Reset the widgets of a refused window."""
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


def _placement(name: str, node: Any, owner: Any) -> tuple[Message, Message]:
    w, x, y, z = map(float, node.wxyz)
    orientation = _messages.SetOrientationMessage(name, (w, x, y, z))
    x, y, z = map(float, node.position)
    position = _messages.SetPositionMessage(name, (x, y, z))
    for message in (orientation, position):
        message.owner = owner
    return orientation, position
