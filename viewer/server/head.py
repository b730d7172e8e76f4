"""Add our front end, in ``front/``, to the ``<head>`` of viser's page; no network is used."""

from __future__ import annotations

import gzip
from functools import cache, lru_cache
from pathlib import Path

from websockets.http11 import Response

_FRONT = Path(__file__).with_name("front")
NOTICE = "notice.js"  # the script that a film needs as well

_SCRIPTS = (
    "link.js", "double_click.js", "bar.js", "answer.js", "jog.js", "names.js", "plot.js", "row.js",
    "numbers.js", "steps.js", "tabs.js", "timeline.js", "tooltips.js", NOTICE,
)  # fmt: skip


@cache
def front_file(name: str) -> str:
    """A text file of our front end."""
    return (_FRONT / name).read_text("utf-8")


@lru_cache(maxsize=1)
def front() -> bytes:
    scripts = "".join(map(front_file, _SCRIPTS))
    return f"<head><style>{front_file('front.css')}</style><script>{scripts}</script>".encode()


def add_head(reply: Response) -> None:
    if reply.status_code != 200 or "text/html" not in reply.headers.get("Content-Type", ""):
        return
    zipped = reply.headers.get("Content-Encoding") == "gzip"
    reply.body = _with_front(bytes(reply.body), zipped)
    del reply.headers["Content-Length"]
    reply.headers["Content-Length"] = str(len(reply.body))


@lru_cache(maxsize=2)  # one page, plain and compressed
def _with_front(page: bytes, zipped: bool) -> bytes:
    plain = gzip.decompress(page) if zipped else page
    begun = plain.replace(b"<head>", front(), 1)
    return gzip.compress(begun) if zipped else begun
