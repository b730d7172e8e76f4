"""How soon the arm moves after a key is pressed on the Jog tab, and slows after it is released.

A window without a browser sends what the browser's script sends: every 20 ms what is held, and at
once when it is released. The servos are emulated behind a serial port, in real time and in a
process of their own; page and arm run in this process, as in ``so101 view --port``. From the
message that leaves the window to the first setpoint that moves (a key), to the first one with less
than 98 % of the speed after a release, and likewise after the last message of a window whose
network is gone. It takes 1.5 s for each of ``--n``: two and a half minutes as it stands.
"""

from __future__ import annotations

import argparse
import asyncio
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
from so101_viewer import serve
from websockets.asyncio.client import ClientConnection

from benchmarks import _common
from so101_motion.common.named_poses import POSES
from so101_motion.common.state import JointState
from so101_motion.drivers.bus.defaults import SERVO_IDS
from so101_motion.planning.goals import JointGoal
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.rig import Rig
from so101_motion.rig.servo_driver import ServoSettings

_raw_window: Any = _common.from_tests("harness.raw_window")

PRESSES = 100
REPEAT = 0.02  # [s], as the browser's script
HELD = 0.35  # [s]
REST = 0.4  # [s]
MOVES = 1e-3  # [rad/s]
SLOWER = 0.98  # share of the fastest setpoint; while a key is held they differ by less


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


def rows(presses: int) -> list[dict[str, Any]]:
    """The three delays."""
    with servos() as port:
        settings = ServoSettings(port=port).with_arm(SERVO_IDS)
        with open_hardware(settings) as rig, serve(rig, port=0) as page:
            widgets = {}
            while "Held" not in widgets:
                gui = page.host.page_context().server.gui
                for uuid, handle in list(gui._gui_input_handle_from_uuid.items()):
                    widgets[str(getattr(handle, "label", ""))] = str(uuid)
                time.sleep(0.1)
            rig.arm.set_torque(True)
            # Away from the folded pose, in which joints are near their stops.
            ready = next(pose.q for pose in POSES if pose.name == "ready")
            rig.arm.start_move(JointGoal(q=ready)).result()
            speeds = Speeds(rig)
            times = asyncio.run(jog(page.url, widgets, presses))
            speeds.end()
    delays: dict[str, list[float]] = {"key to first setpoint that moves": []}
    for begin, end, is_lost in times:
        delays["key to first setpoint that moves"].append(speeds.first_moving(begin) - begin)
        name = "network gone to first slower one" if is_lost else "release to first slower one"
        delays.setdefault(name, []).append(speeds.first_slower(end) - end)
    lost = [name for name, each in delays.items() if not np.isfinite(each).all()]
    if lost:
        raise SystemExit(f"The arm stopped jogging on its way: {', '.join(lost)} has gaps.")
    return [
        {"what": name, **_common.summary(each), "bar": bar}
        for (name, each), bar in zip(
            delays.items(), ("p99 60 ms", "p99 100 ms", "p99 100 ms"), strict=True
        )
    ]


def main() -> None:
    """Measure, print and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=PRESSES, help="presses for each row")
    parser.add_argument("--dry", action="store_true", help="print the table, write no results")
    wanted = parser.parse_args()
    _common.single_thread()
    found = rows(wanted.n)
    if wanted.dry:
        _common.print_table("bench_jog", found)
    else:
        _common.write("bench_jog", found, peers=("viser",))


if __name__ == "__main__":
    main()
