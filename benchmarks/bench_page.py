"""Load time of the page, its processor time at rest, and its update rate while the arm moves.

The page runs in a process of its own, as ``so101 view --sim`` starts it. Beside it runs an empty
page of the same viser, behind the same guard, with only the same words on it: the least that ours
could take. Each in turn is opened in a fresh window whose cache
is empty. A window counts as loaded when the arm's state has been painted; the browser reports when
(element timing), counted from the navigation. It draws without a GPU, on
the processors that the page and the benchmark share, so the ratio says more than the seconds.

Then one window is left open and nobody does anything, which measures the idle page. Last comes a
window without a browser, the websocket alone. It counts what it is sent until viser says that this
was all, takes control, chooses a pose, plans, executes, and counts updates of the arm's place.

Run by hand, ``--empty`` is the other page and not for people.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import shutil
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
import zstandard
from playwright.sync_api import Browser, Page, sync_playwright
from so101_viewer.server.guarded_server import start_guarded
from websockets.asyncio.client import ClientConnection

from benchmarks import _common
from benchmarks.soak_page import BROWSERS, Process, running_page

_raw_window: Any = _common.from_tests("harness.raw_window")

LOADS, IDLE_SECONDS, MOVES = 6, 8.0, 4
WORDS = "Idle, holding"
SIZE, SCALE = {"width": 1280, "height": 720}, 0.5

_WHEN_PAINTED = """
new PerformanceObserver((list) => {
  window.painted = window.painted || list.getEntries()[0].renderTime;
}).observe({ type: 'element', buffered: true });
new MutationObserver((_, observer) => {
  if (!document.body) return;
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let text = texts.nextNode(); text; text = texts.nextNode()) {
    if (!text.nodeValue.includes('WORDS')) continue;
    observer.disconnect();
    let element = text.parentElement;  // the one that is timed is the nearest block
    for (let k = 0; element && k < 4; k++, element = element.parentElement)
      element.setAttribute('elementtiming', 'state');
    // An element that was painted before, with other words, is not timed: then two frames later.
    requestAnimationFrame(() => requestAnimationFrame((painted) =>
      setTimeout(() => { window.painted = window.painted || painted; }, 500)));
    return;
  }
}).observe(document, { childList: true, subtree: true, characterData: true });
""".replace("WORDS", WORDS)


def empty() -> None:
    """Be a page with nothing but the words."""
    server = start_guarded(port=0)
    server.viser.gui.add_html(f"<h3>{WORDS}</h3>")
    print("open", server.url, flush=True)
    threading.Event().wait()


# With a browser


def load(browser: Browser, url: str) -> tuple[Page, float]:
    """A fresh window on ``url``, and how long until the words were painted [s]."""
    context = browser.new_context(viewport=SIZE, device_scale_factor=SCALE)  # type: ignore[arg-type]
    context.add_init_script(_WHEN_PAINTED)
    page = context.new_page()
    page.goto(url, wait_until="commit")
    page.wait_for_function("() => window.painted > 0", timeout=120_000, polling=100)
    painted: float = page.evaluate("window.painted")
    return page, painted / 1000.0


def loads(browser: Browser, urls: Sequence[str], count: int) -> list[list[float]]:
    """How long each of ``urls`` took, ``count`` times in turn [s]."""
    times: list[list[float]] = [[] for _ in urls]
    for _ in range(count):
        for url, taken in zip(urls, times, strict=True):
            page, seconds = load(browser, url)
            taken.append(seconds)
            page.context.close()
    return times


def idle_share(browser: Browser, process: Process) -> float:
    """Share of a core that the page takes while one window looks at it."""
    page, _ = load(browser, process.url)
    page.wait_for_timeout(3000.0)  # the first pictures are drawn
    begin, cpu = time.monotonic(), process.cpu
    page.wait_for_timeout(1000.0 * IDLE_SECONDS)
    share = (process.cpu - cpu) / (time.monotonic() - begin)
    page.context.close()
    return share


# Without one


@dataclass(slots=True)
class Heard:
    """What a window was sent.

    Attributes:
        replay: How long until it had everything there was [s].
        messages: How many of viser's messages that was.
        size: How much that was [bytes].
        rates: How often a second it was told where the arm is, of each motion.
        gaps: Time between one and the next [s].
    """

    replay: float = 0.0
    messages: int = 0
    size: int = 0
    rates: list[float] = field(default_factory=list)
    gaps: list[float] = field(default_factory=list)


class RawWindow:
    """A window without a browser that knows the widgets and when it was told of the arm.

    Args:
        connection: To the page.
    """

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self._widgets: dict[str, dict[str, Any]] = {}
        self.messages = self.size = 0
        self.arm_at: list[float] = []

    async def hear(self) -> bool:
        """Take in what comes next; whether viser says that it was the last of what there was."""
        data = await self._connection.recv()
        assert isinstance(data, bytes)
        unpacked, packed = (int.from_bytes(data[k : k + 8], "little") for k in (0, 8))
        told = zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed], unpacked)
        messages = msgspec.msgpack.decode(told)["messages"]
        self.messages, self.size = self.messages + len(messages), self.size + len(data)
        for message in messages:
            if isinstance(message.get("props"), dict) and "uuid" in message:
                self._widgets[message["uuid"]] = dict(message["props"])
            elif message["type"] == "GuiUpdateMessage":
                self._widgets.setdefault(message["uuid"], {}).update(message["updates"])
        if any(message.get("name", "").startswith("/live/") for message in messages):
            self.arm_at.append(time.perf_counter())
        return any(message["type"] == "ReplayDoneMessage" for message in messages)

    async def press(self, label: str) -> None:
        """Press the button called ``label`` as soon as that is possible, or so in a group."""
        while (found := self._button(label)) is None:
            await asyncio.wait_for(self.hear(), 30.0)
        uuid, value = found
        await self.send("GuiUpdateMessage", uuid=uuid, updates={"value": value})

    async def send(self, kind: str, **fields: Any) -> None:
        """Tell the page something."""
        await self._connection.send(msgspec.msgpack.encode({"type": kind, **fields}))

    def _button(self, label: str) -> tuple[str, object] | None:
        for uuid, props in self._widgets.items():
            if not props.get("disabled"):
                if props.get("label") == label and "options" not in props:
                    return uuid, True
                if label in props.get("options", ()):
                    return uuid, label
        return None

    async def watch(self) -> list[float]:
        """When the page told of the arm, from now until it has been at rest for a while [s]."""
        self.arm_at.clear()
        with contextlib.suppress(TimeoutError):
            while not self.arm_at or time.perf_counter() - self.arm_at[-1] < 1.0:
                await asyncio.wait_for(self.hear(), 1.0 if self.arm_at else 30.0)
        return list(self.arm_at)


async def listen(url: str) -> Heard:
    """Be a window on ``url``, and move the arm a few times."""
    heard = Heard()
    begin = time.perf_counter()
    async with _raw_window.page_connection(url) as connection:
        window = RawWindow(connection)
        while not await window.hear():
            pass
        heard.replay = time.perf_counter() - begin
        heard.messages, heard.size = window.messages, window.size
        for k in range(MOVES):
            await window.press(("ready", "home")[k % 2])
            await asyncio.sleep(0.5)  # as people do; the page takes a target before a plan
            await window.press("Plan")
            await window.press("Execute")
            times = await window.watch()
            heard.rates.append((len(times) - 1) / (times[-1] - times[0]))
            heard.gaps += list(np.diff(times))
    return heard


def lightest(times: Sequence[float]) -> dict[str, float]:
    """Summary with the smallest, which the neighbours have disturbed least [s]."""
    return {**_common.summary(times), "min [s]": min(times)}


def main() -> None:
    """Measure, print and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loads", type=int, default=LOADS, help="times that each page is opened")
    parser.add_argument("--dry", action="store_true", help="print the table, write no results")
    wanted = parser.parse_args()
    _common.single_thread()
    other = [sys.executable, "-m", "benchmarks.bench_page", "--empty"]
    with (
        running_page() as ours,
        running_page(other) as peer,
        sync_playwright() as playwright,
    ):
        found = next(filter(None, map(shutil.which, BROWSERS)), None)
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        load(browser, peer.url)[0].context.close()  # the browser's own first time
        of_empty, of_ours = loads(browser, (peer.url, ours.url), wanted.loads)
        idle = [idle_share(browser, process) for process in (peer, ours)]
        browser.close()
        heard = run_beside(ours.url)
        memory = [process.memory / 1e6 for process in (peer, ours)]
    rows: list[dict[str, Any]] = [
        {"what": "an empty page, until its words are painted", **lightest(of_empty)},
        {"what": "ours, until the state is painted", **lightest(of_ours), "bar": "1.3 s"},
        {"what": "ours over empty, medians", "value": np.median(of_ours) / np.median(of_empty)},
        {"what": "ours over empty, smallest", "value": min(of_ours) / min(of_empty)},
        {"what": "until the server has sent everything [s]", "value": heard.replay},
        {"what": "messages of viser's in that", "value": heard.messages},
        {"what": "their size [MB]", "value": heard.size / 1e6},
        {"what": "states a second while moving, least", "value": min(heard.rates), "bar": "30"},
        {"what": "time between two of them", **_common.summary(heard.gaps)},
        {"what": "empty page at rest, share of a core", "value": idle[0]},
        {"what": "ours at rest, share of a core", "value": idle[1], "bar": "0.02"},
        {"what": "memory of the empty page [MB]", "value": memory[0]},
        {"what": "memory of ours [MB]", "value": memory[1]},
    ]
    if wanted.dry:
        _common.print_table("bench_page", rows)
    else:
        _common.write("bench_page", rows, peers=("viser", "playwright"))


def run_beside(url: str) -> Heard:
    """``listen``, in a thread without an event loop: playwright has one in this."""
    with ThreadPoolExecutor(max_workers=1) as threads:
        return threads.submit(lambda: asyncio.run(listen(url))).result()


if __name__ == "__main__":
    if "--empty" in sys.argv:
        empty()
    else:
        main()
