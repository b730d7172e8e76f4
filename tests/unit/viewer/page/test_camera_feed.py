"""A camera on a real socket of this machine, in its two usual forms."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from so101_viewer.page.camera_feed import CameraFeed

from so101_motion.common.errors import ConfigError


def jpeg(number: int) -> bytes:
    return b"\xff\xd8" + f"picture {number}".encode() + b"\xff\xd9"


class Camera(BaseHTTPRequestHandler):
    count = 0

    def do_GET(self) -> None:
        stream = self.path == "/stream"
        kind = "multipart/x-mixed-replace; boundary=x" if stream else "image/jpeg"
        if self.path == "/lost":
            self.send_error(503)
            return
        self.send_response(200)
        self.send_header("Content-Type", kind if self.path != "/page" else "text/html")
        self.end_headers()
        Camera.count += 1
        if self.path == "/page":
            self.wfile.write(b"<html>")
        elif stream:
            for number in range(3):
                self.wfile.write(
                    b"--x\r\nContent-Type: image/jpeg\r\n\r\n" + jpeg(number) + b"\r\n"
                )
        else:
            self.wfile.write(jpeg(Camera.count))

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Camera)
    thread = threading.Thread(target=lambda: server.serve_forever(poll_interval=0.02))
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    thread.join()
    server.server_close()


def until(condition: Callable[[], object]) -> None:
    for _ in range(1000):
        if condition():
            return
        threading.Event().wait(0.01)
    pytest.fail("did not come true")


@pytest.mark.parametrize("path", ["/picture", "/stream"])
def test_pictures_come_one_after_the_other(address: str, path: str) -> None:
    feed = CameraFeed(address + path)
    until(lambda: feed.picture is not None)
    first = feed.picture
    assert first is not None
    assert first.kind == "image/jpeg"
    assert first.data.startswith(b"\xff\xd8picture")
    assert first.as_url.startswith("data:image/jpeg;base64,/9h")
    if path == "/picture":
        until(lambda: feed.picture is not first)
    else:
        until(lambda: feed.problem == "the stream has ended")
    feed.close()


@pytest.mark.parametrize(("path", "says"), [("/lost", "503"), ("/page", "no picture")])
def test_what_is_wrong_is_told(address: str, path: str, says: str) -> None:
    feed = CameraFeed(address + path)
    until(lambda: says in feed.problem)
    assert feed.picture is None
    feed.close()


def test_nothing_is_fetched_while_nobody_looks(address: str) -> None:
    before, asked = Camera.count, []
    feed = CameraFeed(f"{address}/picture", wanted=lambda: bool(asked.append(1)))
    until(lambda: asked)
    feed.close()
    assert Camera.count == before


@pytest.mark.parametrize("url", ["file:///etc/passwd", "camera", "http://", "ftp://a/b"])
def test_only_web_addresses_are_taken(url: str) -> None:
    with pytest.raises(ConfigError):
        CameraFeed(url)
