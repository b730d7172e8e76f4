"""A browser window without a browser: the websocket, and messages as a page would send them."""

from urllib.parse import parse_qs, urlsplit

import msgspec
import viser
from viser import _messages
from websockets.asyncio.client import connect

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


def page_connection(url):
    """The websocket of a page, from its link; use it with ``async with`` or ``await``."""
    link = urlsplit(url)
    origin = f"http://{link.netloc}"
    return connect(
        f"ws://{link.netloc}",
        subprotocols=[f"viser-v{viser.__version__}"],
        origin=origin,
        additional_headers={"Cookie": f"so101_{link.port}={parse_qs(link.query)['key'][0]}"},
        max_size=None,
    )


class RawWindow:
    """One window. Only after its first picture (``draws``) viser calls it connected."""

    def __init__(self, url, *, draws=True):
        self._url, self._draws = url, draws
        self._connection = None

    async def __aenter__(self):
        self._connection = await page_connection(self._url)
        await self._connection.recv()
        if self._draws:
            await self.send("ViewerCameraMessage", **vars(CAMERA))
        return self

    async def __aexit__(self, kind, error, trace):
        assert self._connection is not None
        await self._connection.close()

    async def send(self, kind, **fields):
        assert self._connection is not None
        await self._connection.send(msgspec.msgpack.encode({"type": kind, **fields}))
        await (await self._connection.ping())

    async def press(self, widget):
        await self.enter(widget, True)

    async def enter(self, widget, value):
        await self.send("GuiUpdateMessage", uuid=widget._impl.uuid, updates={"value": value})

    async def key(self, command):
        await self.send("CommandTriggerMessage", uuid=command._impl.uuid)

    async def drag(self, name, position):
        await self.send(
            "TransformControlsUpdateMessage",
            name=name,
            wxyz=(1.0, 0.0, 0.0, 0.0),
            position=position,
            owner="",
        )
