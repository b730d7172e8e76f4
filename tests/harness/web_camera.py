"""A camera on a socket of this machine: single pictures, a stream, and what goes wrong."""

import io
import itertools
import threading
import time
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from PIL import Image

WIDE, UPRIGHT = (32, 24), (24, 32)


def jpeg(number, size=WIDE):
    """A picture that differs from the one before."""
    file = io.BytesIO()
    Image.new("RGB", size, (40 * number % 256, 90, 160)).save(file, "JPEG")
    return file.getvalue()


class WebCamera(BaseHTTPRequestHandler):
    """Answers ``/picture``, ``/stream``, ``/live`` (endless), ``/page`` (no picture), ``/lost``.

    Attributes:
        count: How often it was asked.
        size: Of its pictures [px].
    """

    count = 0
    size = WIDE

    def do_GET(self):
        WebCamera.count += 1
        if self.path == "/lost":
            self.send_error(503)
            return
        is_stream = self.path in ("/stream", "/live")
        self.send_response(200)
        kind = "multipart/x-mixed-replace; boundary=x" if is_stream else "image/jpeg"
        self.send_header("Content-Type", kind)
        self.end_headers()
        if self.path == "/page":
            self.wfile.write(b"<html>")
        elif is_stream:
            for number in range(3) if self.path == "/stream" else itertools.count():
                head = b"--x\r\nContent-Type: image/jpeg\r\n\r\n"
                try:
                    self.wfile.write(head + jpeg(number) + b"\r\n")
                except OSError:
                    return  # it is not watched any more
                time.sleep(0.0 if self.path == "/stream" else 0.03)
        else:
            self.wfile.write(jpeg(WebCamera.count, WebCamera.size))

    def log_message(self, *_):
        """Say nothing."""


@contextmanager
def web_camera():
    """A camera for the length of a block; its address."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), WebCamera)
    thread = threading.Thread(target=lambda: server.serve_forever(poll_interval=0.02))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
