"""How soon the arm moves after a key is pressed on the Jog tab, and slows after it is released.

Keys are pressed in a real browser, and the time of a key is that of the browser's own event
(``performance.timeOrigin + event.timeStamp``, which is the wall clock). A row of its own says how
much of the delay passes before the page's script has sent its message. That is the browser's share:
on a machine without a graphics card it draws the scene on the processors that the arm needs.
``--no-drawing`` leaves out what is drawn, as a graphics card would take it over.

Before that, a window without a browser sends what the browser's script sends: every 20 ms what is
held, and at once when it is released. From the message that leaves the window to the setpoint, and
likewise after the last message of a window whose network is gone.

The servos are emulated behind a serial port, in real time and in a process of their own; page and
arm run in this process, as in ``so101 view --port``. Setpoints are timed at the end of the cycle in
which they went to the servos. The first that moves, after a key, and the first with less than 98 %
of the speed, after its release. It takes 2.5 s for each of ``--n``: four minutes as it stands.
"""

from __future__ import annotations

import argparse
import asyncio
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from playwright.sync_api import Page, sync_playwright
from so101_viewer import Preview, serve
from websockets.asyncio.client import ClientConnection

from benchmarks import _common
from benchmarks.soak_page import BROWSERS
from so101_motion.common.named_poses import POSES
from so101_motion.common.state import JointState
from so101_motion.drivers.bus.defaults import SERVO_IDS
from so101_motion.planning.goals import JointGoal
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.port_settings import ServoSettings
from so101_motion.rig.rig import Rig

_raw_window: Any = _common.from_tests("harness.raw_window")

PRESSES = 100
REPEAT = 0.02  # [s], as the browser's script
HELD = 0.35  # [s]
REST = 0.4  # [s]
MOVES = 1e-3  # [rad/s]
SLOWER = 0.98  # share of the fastest setpoint; while a key is held they differ by less
SIZE, SCALE = {"width": 1280, "height": 720}, 0.5
CLOCKS = 0.003  # how far apart the clocks of browser and program may seem [s]

_NOTE = """
const at = (t) => (performance.timeOrigin + t) / 1000;
window.noted = [];
for (const kind of ['keydown', 'keyup'])
  addEventListener(kind, (event) => window.noted.push([kind, at(event.timeStamp)]), true);
"""
_NOTE_SENT = """
const send = window.so101.send;
window.so101.send = (...what) => {
  send(...what);
  window.noted.push(['sent', (performance.timeOrigin + performance.now()) / 1000]);
};
"""
_NO_DRAWING = """
for (const way of ['Arrays', 'ArraysInstanced', 'Elements', 'ElementsInstanced'])
  WebGL2RenderingContext.prototype['draw' + way] = () => {};
"""


class Speeds:
    """The speed of every setpoint, and when it left."""

    def __init__(self, rig: Rig) -> None:
        self.rows: list[tuple[float, float]] = []
        self.end = rig.executor.listen(self._take)

    def _take(self, state: JointState) -> None:
        self.rows.append((time.monotonic(), float(np.abs(state.qd_ref).max())))

    def first_moving(self, since: float) -> float:
        """When the first setpoint after ``since`` moved; NaN if none did."""
        return next((t for t, speed in self.rows if t > since and speed > MOVES), np.nan)

    def first_slower(self, since: float) -> float:
        """When the first one after ``since`` was slower than the fastest until then; or NaN."""
        top = 0.0
        for t, speed in self.rows:
            if t > since and speed < SLOWER * top:
                return t
            top = max(top, speed) if t > since - HELD else 0.0
        return np.nan


@contextmanager
def servos() -> Iterator[str]:
    """Emulated servos in a process of their own; their port."""
    with tempfile.TemporaryDirectory() as folder:
        port = str(Path(folder) / "arm")
        command = [sys.executable, "-m", "so101_motion.cli", "emulate", "--realtime"]
        process = subprocess.Popen(
            [*command, "--link", port], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        process.stdout.readline()
        try:
            yield port
        finally:
            process.terminate()
            process.wait(10.0)


async def press(window: ClientConnection, uuid: str, value: object) -> None:
    """Tell a widget its value, as a browser does."""
    message = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}
    await window.send(msgspec.msgpack.encode(message))


async def jog(url: str, widgets: dict[str, str], presses: int) -> list[tuple[float, float, float]]:
    """Press and release; when each began, ended, and when the last message of a lost one went."""
    times = []
    async with _raw_window.page_connection(url) as window:
        reader = asyncio.ensure_future(_listen(window))
        await asyncio.sleep(1.0)
        await press(window, widgets["Start jogging"], True)
        await asyncio.sleep(4.0)
        count = 0
        for k in range(2 * presses):
            way = 1 if k % 2 else -1
            begin = time.monotonic()
            while time.monotonic() - begin < HELD:
                count += 1
                last = time.monotonic()
                await press(window, widgets["Held"], f"{count} {way} 0 0 0 0 0 0")
                await asyncio.sleep(REPEAT)
            is_lost = k >= presses
            end = last if is_lost else time.monotonic()
            if not is_lost:
                count += 1
                await press(window, widgets["Held"], f"{count}")
            times.append((begin, end, float(is_lost)))
            await asyncio.sleep(REST)
        reader.cancel()
    return times


async def _listen(window: ClientConnection) -> None:
    async for _ in window:
        pass


def typed(page: Preview, presses: int, *, draws: bool) -> list[tuple[float, float, float, float]]:
    """Press and release keys in a browser; when each went down, was sent, went up, and was sent."""
    with sync_playwright() as playwright:
        found = next(filter(None, map(shutil.which, BROWSERS)), None)
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        context = browser.new_context(viewport=SIZE, device_scale_factor=SCALE)  # type: ignore[arg-type]
        context.set_default_timeout(120_000)
        context.add_init_script(_NOTE + ("" if draws else _NO_DRAWING))
        window = context.new_page()
        window.goto(page.url)
        window.get_by_role("tab", name="Jog", exact=True).click()
        window.get_by_role("button", name="Start jogging", exact=True).click()
        window.get_by_label("gripper, open").and_(window.locator(":enabled")).wait_for()
        window.evaluate(_NOTE_SENT)
        _check_clocks(window)
        window.wait_for_timeout(4000.0)
        for k in range(presses):
            key = "qa"[k % 2]
            window.keyboard.down(key)
            window.wait_for_timeout(1000.0 * HELD)
            window.keyboard.up(key)
            window.wait_for_timeout(1000.0 * REST)
        _check_clocks(window)
        noted = window.evaluate("window.noted")
        browser.close()
    sent = [t for kind, t in noted if kind == "sent"]
    to_monotonic = time.monotonic() - time.time()
    events = [
        (t + to_monotonic, next((s for s in sent if s >= t), np.nan) + to_monotonic)
        for kind, t in noted
        if kind != "sent"
    ]
    return [(*down, *up) for down, up in zip(events[::2], events[1::2], strict=True)]


def _check_clocks(window: Page) -> None:
    """End the benchmark if the browser's clock is not this program's."""
    before = time.time()
    there = float(window.evaluate("(performance.timeOrigin + performance.now()) / 1000"))
    if not before - CLOCKS <= there <= time.time() + CLOCKS:
        raise SystemExit(f"The browser's clock is {there - before:.4f} s from this program's.")


def rows(presses: int, *, draws: bool) -> list[dict[str, Any]]:
    """All delays."""
    with servos() as port:
        settings = ServoSettings(port=port).with_arm(SERVO_IDS)
        with open_hardware(settings) as rig, serve(rig, port=0) as page:
            widgets = {}
            while "Held" not in widgets:
                gui = page.page_context().server.gui
                for uuid, handle in list(gui._gui_input_handle_from_uuid.items()):
                    widgets[str(getattr(handle, "label", ""))] = str(uuid)
                time.sleep(0.1)
            rig.arm.set_torque(True)
            # Away from the folded pose, in which joints are near their stops.
            ready = next(pose.q for pose in POSES if pose.name == "ready")
            rig.arm.move(JointGoal(q=ready))
            speeds = Speeds(rig)
            messages = asyncio.run(jog(page.url, widgets, presses))
            rig.arm.stop()  # ends the jogging
            rig.arm.set_torque(True)  # a busy machine may have ended that in a fault
            keys = typed(page, presses, draws=draws)
            speeds.end()
    drawing = "" if draws else ", nothing drawn"
    released, lost = ([each for each in messages if each[2] == k] for k in (0.0, 1.0))
    moving, slower = speeds.first_moving, speeds.first_slower
    delays = {
        f"key in a browser to first setpoint that moves{drawing}": [
            moving(t) - t for t, *_ in keys
        ],
        f"key in a browser to its message{drawing}": [sent - t for t, sent, *_ in keys],
        f"release in a browser to first slower one{drawing}": [
            slower(t) - t for _, _, t, _ in keys
        ],
        f"release in a browser to its message{drawing}": [sent - t for _, _, t, sent in keys],
        "message to first setpoint that moves": [moving(t) - t for t, *_ in messages],
        "message of a release to first slower one": [slower(t) - t for _, t, _ in released],
        "network gone to first slower one": [slower(t) - t for _, t, _ in lost],
    }
    gaps = [name for name, each in delays.items() if not np.isfinite(each).all()]
    if gaps:
        raise SystemExit(f"The arm stopped jogging on its way: {', '.join(gaps)} has gaps.")
    bars = ("p99 60 ms", "", "p99 100 ms", "", "", "", "p99 100 ms")
    return [
        {"what": name, **_common.summary(each), "bar": bar}
        for (name, each), bar in zip(delays.items(), bars, strict=True)
    ]


def main() -> None:
    """Measure, print and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=PRESSES, help="presses for each row")
    parser.add_argument("--dry", action="store_true", help="print the table, write no results")
    parser.add_argument(
        "--no-drawing",
        action="store_true",
        help="the browser draws no picture; adds rows to those with pictures",
    )
    wanted = parser.parse_args()
    _common.single_thread()
    found = rows(wanted.n, draws=not wanted.no_drawing)
    if wanted.dry:
        _common.print_table("bench_jog", found)
    else:
        _common.update("bench_jog", found, peers=("viser", "playwright"))


if __name__ == "__main__":
    main()
