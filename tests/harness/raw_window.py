"""A browser window without a browser: the websocket, and messages as a page would send them."""

from __future__ import annotations

from types import TracebackType
from typing import Any
from urllib.parse import parse_qs, urlsplit

import msgspec
import viser
from viser import _messages
from websockets.asyncio.client import ClientConnection, connect

CAMERA = _messages.ViewerCameraMessage(
    wxyz=(1.0, 0.0, 0.0, 0.0),
    position=(1.0, 1.0, 1.0),
    fov=1.0,
    near=0.01,
    far=100.0,
    image_height=100,
    image_width=100,
    look_at=(0.0, 0.0, 0.0),
    up_direction=(0.0, 0.0, 1.0),
)


def page_connection(url: str) -> connect:
    """The websocket of a page, from its link; use it with ``async with`` or ``await``."""
    link = urlsplit(url)
    origin = f"http://{link.netloc}"
    return connect(
        f"ws://{link.netloc}",
        subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
        origin=origin,  # type: ignore[arg-type]
        additional_headers={"Cookie": f"so101_{link.port}={parse_qs(link.query)['key'][0]}"},
        max_size=None,
    )


class RawWindow:
    """One window; use it in an ``async with`` block.

    Args:
        url: Of the page.
        draws: Whether it has drawn its first picture; only then viser calls it connected.
    """

    def __init__(self, url: str, *, draws: bool = True) -> None:
        self._url, self._draws = url, draws
        self._connection: ClientConnection | None = None

    async def __aenter__(self) -> RawWindow:
        self._connection = await page_connection(self._url)
        await self._connection.recv()
        if self._draws:
            await self.send("ViewerCameraMessage", **vars(CAMERA))
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert self._connection is not None
        await self._connection.close()

    async def send(self, kind: str, **fields: Any) -> None:
        assert self._connection is not None
        await self._connection.send(msgspec.msgpack.encode({"type": kind, **fields}))
        await (await self._connection.ping())

    async def press(self, widget: Any) -> None:
        await self.enter(widget, True)

    async def enter(self, widget: Any, value: object) -> None:
        await self.send("GuiUpdateMessage", uuid=widget._impl.uuid, updates={"value": value})

    async def key(self, command: Any) -> None:
        await self.send("CommandTriggerMessage", uuid=command._impl.uuid)

    async def drag(self, name: str, position: tuple[float, float, float]) -> None:
        await self.send(
            "TransformControlsUpdateMessage",
            name=name,
            wxyz=(1.0, 0.0, 0.0, 0.0),
            position=position,
            owner="",
        )
