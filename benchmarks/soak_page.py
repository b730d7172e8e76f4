"""Run the page for ten minutes with three busy browser windows, and watch its resources.

The page runs in a process of its own, as ``so101 view --sim`` starts it. First nobody does anything
for a while, which measures the idle page with its three windows. Then one window,
which has control, chooses a pose, plans and executes, again and again; the others look on, and one
of them is closed and opened anew every so often. A fourth listener without a browser, the websocket
alone, counts what the page sends while the arm moves: browsers without a GPU draw less than that.

Of the process are noted: processor time, memory, threads and open files. Memory is compared between
the end and the first quarter, when everything has been used once.

``--seconds`` sets how long; the committed result is of 600.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright

from benchmarks import _common
from benchmarks._machine import cpu_time, memory

_raw_window: Any = _common.from_tests("harness.raw_window")

SECONDS = 600.0
IDLE_SHARE, REOPEN_EVERY = 0.05, 8
"""How much of the time nothing is done; after how many moves an onlooker is closed and opened."""

_VIEW = (
    *(sys.executable, "-m", "so101_motion.cli", "view"),
    *("--sim", "--no-browser", "--web-port", "0"),
)
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_FEW_PICTURES = """
window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 250);
window.cancelAnimationFrame = clearTimeout;
"""
"""A browser without a GPU would take the whole computer to draw, and measure nothing but that."""


@dataclass(slots=True)
class Process:
    """A running page, seen from outside.

    Attributes:
        popen: The process.
        url: The link to the page.
    """

    popen: subprocess.Popen[str]
    url: str

    @property
    def cpu(self) -> float:
        """Processor time so far, without its children's [s]."""
        return cpu_time(self.popen.pid)

    @property
    def memory(self) -> int:
        """Resident memory [bytes]."""
        return memory(self.popen.pid)

    @property
    def threads(self) -> int:
        """How many threads it has."""
        return len(os.listdir(f"/proc/{self.popen.pid}/task"))

    @property
    def files(self) -> int:
        """How many files and connections it has open."""
        return len(os.listdir(f"/proc/{self.popen.pid}/fd"))


@dataclass(slots=True)
class Soak:
    """The findings of a soak.

    Attributes:
        idle_cpu: Share of a core that the idle page takes.
        load: How long a window took until Plan was there, each [s].
        moves: How often the arm was moved.
        rates: Messages a second to one listener, of each move.
        cpu: Share of a core during all of it.
        memory: Of the process, sampled after every move [bytes].
        threads: Likewise.
        files: Likewise.
        problems: What the windows' scripts complained of.
    """

    idle_cpu: float = 0.0
    load: list[float] = field(default_factory=list)
    moves: int = 0
    rates: list[float] = field(default_factory=list)
    cpu: float = 0.0
    memory: list[int] = field(default_factory=list)
    threads: list[int] = field(default_factory=list)
    files: list[int] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    @property
    def memory_growth(self) -> float:
        """Median memory of the last quarter against that of the second one, as a share."""
        parts = np.array_split(np.array(self.memory, dtype=float), 4)
        return float(np.median(parts[3]) / np.median(parts[1]) - 1.0)


@contextlib.contextmanager
def running_page(command: Sequence[str] = _VIEW) -> Iterator[Process]:
    """A page in a process of its own, until the end of the block.

    Args:
        command: Serves it and prints ``open`` and the link; else ``so101 view --sim``.
    """
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    ) as popen:
        assert popen.stdout is not None
        line = popen.stdout.readline()
        try:
            yield Process(popen, line.split()[1])
        finally:
            popen.send_signal(signal.SIGINT)


class Listener:
    """A window without a browser that counts what it is sent.

    Args:
        url: The link to the page.
    """

    def __init__(self, url: str) -> None:
        self.count = 0
        self._url = url
        self._over = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._listen()))

    def __enter__(self) -> Listener:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    async def _listen(self) -> None:
        async with _raw_window.page_connection(self._url) as connection:
            camera = {"type": "ViewerCameraMessage", **vars(_raw_window.CAMERA)}
            await connection.send(msgspec.msgpack.encode(camera))
            while not self._over.is_set():
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(connection.recv(), 0.2)
                    self.count += 1


class Windows:
    """Browser windows on the page.

    Args:
        browser: The browser.
        url: The link.
        soak: Takes how they fared.
    """

    def __init__(self, browser: Browser, url: str, soak: Soak) -> None:
        self._browser, self._url, self._soak = browser, url, soak
        self._contexts: list[BrowserContext] = []
        self.pages: list[Page] = []

    def open(self) -> None:
        """One more."""
        context = self._browser.new_context(
            viewport={"width": 900, "height": 600}, device_scale_factor=0.25
        )
        context.add_init_script(_FEW_PICTURES)
        page = context.new_page()
        page.on("pageerror", lambda error: self._soak.problems.append(str(error)))
        begin = time.monotonic()
        page.goto(self._url)
        page.get_by_role("button", name="Plan", exact=True).wait_for(timeout=120_000)
        self._soak.load.append(time.monotonic() - begin)
        self._contexts.append(context)
        self.pages.append(page)

    def reopen_last(self) -> None:
        """Close the newest and open another."""
        self._contexts.pop().close()
        self.pages.pop()
        self.open()


def move_once(page: Page, pose: str, listener: Listener) -> float:
    """Choose a pose, plan, execute, arrive; messages a second on the way."""
    button = page.get_by_role("button", name=pose, exact=True)
    button.dispatch_event("click")
    page.get_by_text("Reachable. Press Plan.").wait_for(timeout=60_000)
    page.get_by_role("button", name="Plan", exact=True).dispatch_event("click")
    execute = page.locator("button:enabled", has_text="Execute").first
    execute.wait_for(timeout=60_000)
    execute.dispatch_event("click")
    page.get_by_text("Moving").first.wait_for(timeout=60_000)
    begin, count = time.monotonic(), listener.count
    page.wait_for_timeout(500)
    rate = (listener.count - count) / (time.monotonic() - begin)
    page.get_by_text("Arrived").first.wait_for(timeout=60_000)
    return rate


def soak_for(seconds: float, *, windows: int = 3) -> Soak:
    """Run it.

    Args:
        seconds: How long.
        windows: How many browser windows.
    """
    soak = Soak()
    with running_page() as process, sync_playwright() as playwright:
        found = next(filter(None, map(shutil.which, BROWSERS)), None)
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        opened = Windows(browser, process.url, soak)
        for _ in range(windows):
            opened.open()
        begin, cpu = time.monotonic(), process.cpu
        opened.pages[0].wait_for_timeout(1000.0 * max(IDLE_SHARE * seconds, 5.0))
        soak.idle_cpu = (process.cpu - cpu) / (time.monotonic() - begin)
        with Listener(process.url) as listener:
            while time.monotonic() - begin < seconds:
                pose = ("ready", "home")[soak.moves % 2]
                soak.rates.append(move_once(opened.pages[0], pose, listener))
                soak.moves += 1
                if soak.moves % REOPEN_EVERY == 0:
                    opened.reopen_last()
                soak.memory.append(process.memory)
                soak.threads.append(process.threads)
                soak.files.append(process.files)
        soak.cpu = (process.cpu - cpu) / (time.monotonic() - begin)
        browser.close()
    return soak


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description="A page with three windows for a while.")
    parser.add_argument("--seconds", type=float, default=SECONDS)
    seconds = parser.parse_args().seconds
    soak = soak_for(seconds)
    rows: list[dict[str, Any]] = [
        {"what": "seconds", "value": seconds},
        {"what": "moves made by the window in control", "value": soak.moves},
        {"what": "windows opened", "value": len(soak.load)},
        {"what": "idle page, share of a core", "value": soak.idle_cpu, "bar": "0.05"},
        {"what": "moving most of the time, share of a core", "value": soak.cpu},
        {
            "what": "messages a second while moving, median",
            "value": float(np.median(soak.rates)),
            "bar": "30",
        },
        {"what": "until the page can be used", **_common.summary(soak.load), "bar": "2 s"},
        {"what": "memory at the end [MB]", "value": soak.memory[-1] / 1e6},
        {"what": "its growth after the first half", "value": soak.memory_growth, "bar": "0.05"},
        {"what": "threads, most", "value": max(soak.threads)},
        {"what": "files and connections, most", "value": max(soak.files)},
        {"what": "complaints of the browsers' scripts", "value": len(soak.problems), "bar": "0"},
    ]
    _common.write("soak_page", rows, peers=("viser",))


if __name__ == "__main__":
    main()
