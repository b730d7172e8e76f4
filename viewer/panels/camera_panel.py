"""A camera's picture over the scene, from the camera's address or the machine that has it.

An address sends a JPEG or PNG for each request, or a stream of JPEG. A thread keeps the newest
picture as the camera sent it, or why there is none, and tries again.
"""

from __future__ import annotations

import base64
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from http.client import HTTPException
from socket import gaierror
from typing import BinaryIO
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

import viser

from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.viam.client import MachineRig

from ..page import markup
from ..page.page_context import PageContext, Part

PERIOD = 0.2
"""Least time between two pictures [s]; chosen: often enough to see what happens, and light on the
network."""

PATIENCE = 4.0  # how long to wait for the camera [s]; chosen
RETRY = 2.0  # how long until it is tried again [s]; chosen
LARGEST = 4_000_000  # largest picture that is taken [byte]; chosen

_KINDS = {b"\xff\xd8": "image/jpeg", b"\x89P": "image/png"}
_END = b"\xff\xd9"


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A picture as a ``data:`` address, and when it came, ``time.monotonic`` [s]."""

    url: str
    t: float


def check_camera(camera: str, *, has_machine: bool) -> None:
    """Raise ``ConfigError`` for what is no address nor, where there is a machine, a name."""
    parts = urlsplit(camera)
    if parts.scheme in ("http", "https") and parts.hostname:
        return
    if not has_machine or not camera or "/" in camera:
        also = ", or the name of a camera of the machine" if has_machine else ""
        raise ConfigError(
            "camera",
            camera,
            f"must be an address that begins with http://{also}; ustreamer --device /dev/video0"
            " --port 8090 gives a camera of this computer one, http://127.0.0.1:8090/stream",
        )


class CameraFeed:
    """Fetches pictures until it is closed.

    Args:
        camera: The http or https address of a picture or a stream, or the machine's name of it;
            ``ConfigError`` if it is neither.
        wanted: Whether anybody is watching; otherwise nothing is fetched.
        ask: Asks the machine for a picture of the camera of that name; None without a machine.

    Attributes:
        picture: The newest one; None before the first.
        problem: Why there is no newer one; empty when there is.
    """

    def __init__(
        self,
        camera: str,
        wanted: Callable[[], bool] = lambda: True,
        ask: Callable[[str], bytes] | None = None,
    ) -> None:
        check_camera(camera, has_machine=ask is not None)
        self._camera, self._ask = camera, None if "/" in camera else ask
        self._wanted = wanted
        self.picture: Picture | None = None
        self.problem = ""
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="so101-viewer-camera", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._closing.set()
        self._thread.join(2.0 * PATIENCE)

    def _run(self) -> None:
        while not self._closing.is_set():
            pause = PERIOD
            if self._wanted():
                try:
                    self._fetch()
                except (OSError, HTTPException, ValueError, So101Error) as error:
                    self.problem, pause = _words(error), RETRY
            self._closing.wait(pause)

    def _fetch(self) -> None:
        if self._ask is not None:
            self._take(self._ask(self._camera))
            return
        request = Request(self._camera, headers={"User-Agent": "so101_motion"})
        with urlopen(request, timeout=PATIENCE) as reply:
            if "multipart" in reply.headers.get("Content-Type", ""):
                for data in _jpegs(reply):
                    self._take(data)
                    if self._closing.is_set() or not self._wanted():
                        return
                raise ValueError("the stream has ended")
            self._take(reply.read(LARGEST + 1))

    def _take(self, data: bytes) -> None:
        kind = _KINDS.get(data[:2])
        if kind is None or len(data) > LARGEST:
            raise ValueError("it sends no picture (JPEG or PNG)")
        now = time.monotonic()
        if self.picture is None or now - self.picture.t >= PERIOD:
            url = f"data:{kind};base64,{base64.b64encode(data).decode()}"
            self.picture = Picture(url=url, t=now)
        self.problem = ""


def _words(error: Exception) -> str:
    if isinstance(error, HTTPError):
        return f"the camera answers {error.code} {error.reason}; check its address"
    cause = error.reason if isinstance(error, URLError) else error
    if isinstance(cause, ConnectionRefusedError):
        return "nothing answers at its address; is the camera on?"
    if isinstance(cause, TimeoutError):
        return "the camera does not answer"
    if isinstance(cause, gaierror):
        return "its address does not exist; check it"
    return str(cause) or type(cause).__name__


def _jpegs(stream: BinaryIO) -> Iterator[bytes]:
    """The pictures of a stream, whatever stands between them."""
    buffer = b""
    while chunk := stream.read1(65_536):  # type: ignore[attr-defined]  # http.client has it
        buffer += chunk
        while (begin := buffer.find(b"\xff\xd8")) >= 0:
            end = buffer.find(_END, begin)
            if end < 0:
                buffer = buffer[begin:]
                break
            yield buffer[begin : end + 2]
            buffer = buffer[end + 2 :]
        if len(buffer) > LARGEST:
            raise ValueError("it sends no JPEG stream")


OLD = 2.0  # a picture older than this is grey, and says so [s]; chosen
_SIZE = (228, 225)  # width and height of the panel [px]; chosen: a picture of 4:3 is not cut

_ASIDE, _ABOVE = 12, 52
"""Distance from the right and from the lower edge of the scene [px]; chosen: over the floor, clear
of an arm at home in narrow windows too, of alerts, and of the folded plots."""


class CameraPart(Part):
    """Shows the pictures of a camera: its address, or the machine's name of it."""

    def __init__(
        self, context: PageContext, camera: str, machine: MachineRig | None = None
    ) -> None:
        server = context.server
        self.feed = CameraFeed(
            camera,
            wanted=lambda: bool(server.get_clients()),
            ask=None if machine is None else machine.picture,
        )
        self._shown: object = None
        panel = context.gui.add_panel()
        with panel.add_tab("Camera", viser.Icon.CAMERA):
            self._html = context.gui.add_html(markup.small("No picture yet."))
        width, height = _SIZE
        panel.float(x=-_ASIDE, y=-_ABOVE, width=width, height=height)

    def refresh(self) -> bool:
        before, self._shown = self._shown, (self.feed.picture, self._is_old(), self.feed.problem)
        return self._shown != before

    def _is_old(self) -> bool:
        picture = self.feed.picture
        return picture is None or time.monotonic() - picture.t > OLD

    def show(self) -> None:
        picture, is_old = self.feed.picture, self._is_old()
        says = "" if not is_old else self.feed.problem or "the camera sends no picture"
        self._html.content = markup.picture(None if picture is None else picture.url, says)

    def close(self) -> None:
        self.feed.close()
