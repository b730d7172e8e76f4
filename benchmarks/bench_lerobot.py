"""LeRobot's robot on the emulated arm: how soon an action is sent, how well one is replayed.

    PYTHONPATH=tests python -m benchmarks.bench_lerobot

In pretended time, so figures are those of the emulated servo and of the control cycle, not of this
machine. The same recording, a person's reaches at 30 frames a second, is replayed by the plugin and
by a client that does what LeRobot's own follower does: P 16, no caps, each action a goal at once.
The plugin has caps of 180 deg/s and 500 deg/s^2, which the recording keeps.
"""

from __future__ import annotations

import importlib
import json
import logging
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.port.serial_port import SerialPort

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))
_pair: Any = importlib.import_module("harness.emulated_pair")
_rig: Any = importlib.import_module("harness.emulated_rig")
_lerobot: Any = importlib.import_module("harness.lerobot_bench")
_referee: Any = importlib.import_module("referee")

MIDDLES_DEG: Array = np.array(_rig.MIDDLES_DEG)
FPS, SECONDS, DT = 30, 20.0, 0.01
JAW = 30.0
LOWERED = np.array([0.0, -25.0, 25.0, 20.0, 0.0])  # keeps the reaches off the table and the arm


def recording(seed: int = 3) -> Array:
    """Actions at each 10 ms, shape (n, 5), LeRobot's degrees."""
    reaches: Array = 0.5 * _pair.human_motion(SECONDS, seed, dt=DT)[:, :5]
    return np.asarray(reaches + LOWERED)


def at_frame(rows: Array, k: int) -> Array:
    """The row of the frame that the ``k``-th 10 ms belong to."""
    row: Array = rows[int(k * DT * FPS) * 100 // FPS]
    return row


def replayed_by_plugin(folder: Path, rows: Array) -> Array:
    """True angles at each 10 ms, LeRobot's degrees, shape (n, 5)."""
    start = (*np.radians(rows[0] + MIDDLES_DEG), 0.5)
    with _lerobot.lerobot_bench(folder, q_start=start) as bench:
        robot = bench.connected(*rows[0], JAW)
        seen = []
        for k in range(len(rows)):
            if k == 0 or int(k * DT * FPS) != int((k - 1) * DT * FPS):
                robot.send_action(_lerobot.action(*at_frame(rows, k), JAW))
            bench.advance(DT)
            seen.append(bench.q_deg[:5] - MIDDLES_DEG)
        robot.disconnect()
    return np.array(seen)


def replayed_as_stock(folder: Path, rows: Array) -> Array:
    """The same by a client that writes goals as LeRobot's follower does."""
    start = (*np.radians(rows[0] + MIDDLES_DEG), 0.5)
    with _lerobot.lerobot_bench(folder, q_start=start) as bench:
        bus = Bus(SerialPort(str(bench.port)), reply_timeout=0.2)
        middles = {}
        for i in range(1, 6):
            bus.write(i, reg.P_GAIN, 16)
            bus.write(i, reg.MAX_ACCELERATION, 254)
            bus.write(i, reg.ACCELERATION, 254)
            bus.write(i, reg.GOAL_VELOCITY, 3400)  # as fast as it can
            middles[i] = (bus.read(i, reg.MIN_POSITION) + bus.read(i, reg.MAX_POSITION)) / 2.0
            goal = round(middles[i] + rows[0][i - 1] * 4095.0 / 360.0)
            bus.write(i, reg.GOAL_POSITION, goal)
            bus.write(i, reg.TORQUE_ENABLE, 1)
        bench.advance(2.0)
        seen = []
        for k in range(len(rows)):
            if k == 0 or int(k * DT * FPS) != int((k - 1) * DT * FPS):
                q = at_frame(rows, k)
                goals = {i: int(middles[i] + q[i - 1] * 4095.0 / 360.0) for i in range(1, 6)}
                data = {i: goal.to_bytes(2, "little") for i, goal in goals.items()}
                bus.sync_write(reg.GOAL_POSITION.address, data)
            bench.advance(DT)
            seen.append(bench.q_deg[:5] - MIDDLES_DEG)
        bus.close()
    return np.array(seen)


def measured(rows: Array, seen: Array) -> dict[str, Any]:
    """Lag and what is left, all joints together and each."""
    lag, rms = _pair.best_shift(rows, seen, DT, longest=0.3)
    edge, k = 30, round(lag / DT)
    off = seen[edge + k : len(seen) - edge + k] - rows[edge : len(rows) - edge]
    return {
        "lag_ms": round(1000.0 * lag),
        "rms_deg": round(rms, 2),
        "each_deg": [round(float(each), 2) for each in np.sqrt(np.mean(off**2, axis=0))],
    }


def latency(folder: Path, n: int = 200) -> dict[str, Any]:
    """From ``send_action`` to the first command that heeds it [ms], at any phase of the cycle."""
    rng, taken = np.random.default_rng(5), []
    ready = np.array([0.0, -40.0, 40.0, 55.0, 0.0])
    start = (*np.radians(ready + MIDDLES_DEG), 0.5)
    with _lerobot.lerobot_bench(folder, q_start=start) as bench:
        robot = bench.connected(*ready, JAW)
        for k in range(n):
            bench.advance(0.3 + rng.uniform(0.0, DT))
            before, begin = bench.rig.arm.state.q_ref, bench.clock.now()
            robot.send_action(_lerobot.action((-1.0) ** k, *ready[1:], JAW))
            while np.array_equal(bench.rig.arm.state.q_ref, before):
                bench.advance(0.0005)
            taken.append(1000.0 * (bench.clock.now() - begin))
        robot.disconnect()
    return {
        "n": n,
        "median_ms": round(float(np.median(taken)), 1),
        "p99_ms": round(float(np.percentile(taken, 99)), 1),
    }


def main() -> None:
    """Measure, print, write."""
    logging.disable(logging.WARNING)
    rows = recording()
    told: dict[str, Any] = {}
    rules = ("travel", "limits", "distance", "seed", "stop", "motion", "command")
    for name, run in (
        ("plugin", lambda folder: measured(rows, replayed_by_plugin(folder, rows))),
        ("as_stock", lambda folder: measured(rows, replayed_as_stock(folder, rows))),
        ("latency", latency),
    ):
        with tempfile.TemporaryDirectory() as folder, _referee.refereed(breaks=rules):
            told[name] = run(Path(folder))
        print(name, told[name], flush=True)
    (ROOT / "benchmarks" / "results" / "bench_lerobot.json").write_text(
        json.dumps(told, indent=1) + "\n"
    )


if __name__ == "__main__":
    main()
