"""The LeRobot plugin on emulated arms: latency of actions, replay of a recording, and two arms.

    python -m benchmarks.bench_lerobot
    python -m benchmarks.bench_lerobot --two-arms 10

In simulated time, so figures are those of the emulated servo and of the control cycle, not of this
machine. The same recording, a person's reaches at 30 frames a second, is replayed by the plugin and
by a client that does what LeRobot's own follower does: P 16, no caps, each action a goal at once;
where LeRobot is installed (in the environment that ``make test-lerobot`` makes) by that one, too.
The plugin has caps of 180 deg/s and 500 deg/s^2, which the recording keeps.

``--two-arms MINUTES`` runs nothing but teleoperation of two followers by two leaders at 60 Hz, in
real time, by the calls and the sleep of LeRobot's own loop: four emulators in processes of their
own, with the time of the wire, and all else in one process. It wants a machine with nothing else to
do. Warnings in the log after the first approach are counted and listed.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import json
import logging
import resource
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common
from benchmarks.emulated_port import emulated_port
from so101_motion.common.geometry import Array
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.port.serial_port import SerialPort

ROOT = Path(__file__).parents[1]
_pair: Any = _common.from_tests("harness.emulated_pair")
_rig: Any = _common.from_tests("harness.emulated_rig")
_lerobot: Any = _common.from_tests("harness.lerobot_bench")
_referee: Any = _common.from_tests("referee.official")

MIDDLES_DEG: Array = np.array(_rig.MIDDLES_DEG)
FPS, SECONDS, DT = 30, 20.0, 0.01
JAW = 30.0
LOWERED = np.array([0.0, -25.0, 25.0, 20.0, 0.0])  # keeps the reaches off the table and the arm

SIDES = ("left", "right")
RATE = 60.0  # of teleoperation [Hz]
ABOVE = np.array([0.0, -20.0, 0.0, -20.0, 0.0])  # keeps arms that reach for minutes off the table
HELD, GUIDED_FROM = 25.0, 30.0  # until a hand keeps a leader still, and from when it guides it [s]
SETTLED = 3.0  # of teleoperation after the way to where the leaders are [s]


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
                bus.read(1, reg.PRESENT_POSITION)  # answered after the goals were heard
            bench.advance(DT)
            seen.append(bench.q_deg[:5] - MIDDLES_DEG)
        bus.close()
    return np.array(seen)


def replayed_by_stock(folder: Path, rows: Array) -> Array:
    """The same by LeRobot's own follower."""
    stock: Any = importlib.import_module("lerobot.robots.so_follower")
    start = (*np.radians(rows[0] + MIDDLES_DEG), 0.5)
    with _lerobot.lerobot_bench(folder, q_start=start) as bench:
        config = stock.SO101FollowerConfig(port=str(bench.port), id="arm", calibration_dir=folder)
        config.num_read_retries = 1000  # its patience is 50 ms of the wall clock
        robot = stock.SO101Follower(config)
        robot.connect(calibrate=False)
        robot.bus.calibration = robot.bus.read_calibration()
        robot.send_action(_lerobot.action(*rows[0], JAW))
        robot.get_observation()
        bench.advance(2.0)
        seen = []
        for k in range(len(rows)):
            if k == 0 or int(k * DT * FPS) != int((k - 1) * DT * FPS):
                robot.send_action(_lerobot.action(*at_frame(rows, k), JAW))
                robot.get_observation()  # likewise
            bench.advance(DT)
            seen.append(bench.q_deg[:5] - MIDDLES_DEG)
        robot.disconnect()
    return np.array(seen)


def has_lerobot() -> bool:
    """Whether the genuine LeRobot is installed."""
    try:
        importlib.metadata.version("lerobot")
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


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


class _Warnings(logging.Handler):
    """Keeps what is warned of."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.found: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.found.append(record.getMessage())


def leading_hand(seconds: float, seed: int) -> str:
    """A script of a hand that holds all joints, and then leads them for so long."""
    every = 0.05
    rows = 0.5 * _pair.human_motion(seconds, seed, dt=every)[:, :5] + LOWERED + ABOVE + MIDDLES_DEG
    lines = [f"{t} {joint} start" for joint in _pair.JOINTS for t in (0, HELD)]
    lines += [f"{GUIDED_FROM} gripper {JAW}"]
    for joint, column in zip(_pair.JOINTS, rows.T, strict=False):
        lines += [f"{GUIDED_FROM + every * k:.2f} {joint} {q:.3f}" for k, q in enumerate(column)]
    return "\n".join(lines) + "\n"


def two_arms(folder: Path, minutes: float) -> dict[str, Any]:
    """Teleoperation of two followers by two leaders in real time, as LeRobot's loop does it."""
    seconds = 60.0 * minutes
    with ExitStack() as stack:
        ports = {}
        for seed, name in enumerate(("left", "right", "left_leader", "right_leader")):
            script = leading_hand(seconds + 60.0, seed) if seed >= 2 else ""
            port = emulated_port("--latency", "0.001", hand=script)
            ports[name] = stack.enter_context(port)
        arms = (_lerobot.SO101MotionArmConfig(port=ports[side]) for side in SIDES)
        config = _lerobot.BiSO101MotionConfig(*arms, id="two", calibration_dir=folder)
        robot = _lerobot.BiSO101Motion(config)
        robot.connect(calibrate=False)
        stack.callback(robot.disconnect)
        leaders = {}
        for side in SIDES:
            own = {"port": ports[f"{side}_leader"], "id": side, "calibration_dir": folder}
            leader = _lerobot.SO101MotionLeader(_lerobot.SO101MotionLeaderConfig(**own))
            leader.connect(calibrate=False)
            stack.callback(leader.disconnect)
            leaders[f"{side}_"] = leader

        def once() -> None:
            robot.get_observation()
            robot.send_action(
                {f"{s}{k}": v for s, each in leaders.items() for k, v in each.get_action().items()}
            )

        def loop(seconds: float) -> list[float]:
            took, begin = [], time.perf_counter()
            while (now := time.perf_counter()) - begin < seconds:
                once()
                took.append(time.perf_counter() - now)
                time.sleep(max(1.0 / RATE - took[-1], 0.0))
            return took

        once()  # the way to where the leaders are
        loop(SETTLED)
        warnings = _Warnings()
        logging.getLogger().addHandler(warnings)
        stack.callback(logging.getLogger().removeHandler, warnings)
        usage, begin = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
        took = loop(seconds)
        passed, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_SELF)
    spent = after.ru_utime + after.ru_stime - usage.ru_utime - usage.ru_stime
    median, p99 = np.percentile(took, (50.0, 99.0))
    return {
        "what": "two followers, two leaders, 60 Hz, real time, four emulators beside it",
        "minutes": round(passed / 60.0, 2),
        "loops": len(took),
        "loops_per_s": round(len(took) / passed, 2),
        "median_ms": round(1000.0 * float(median), 2),
        "p99_ms": round(1000.0 * float(p99), 2),
        "longest_ms": round(1000.0 * max(took), 1),
        "longer_than_a_period": int(np.sum(np.array(took) > 1.0 / RATE)),
        "processors_used": round(spent / passed, 2),
        "warnings": len(warnings.found),
        "warned_of": sorted(set(warnings.found))[:10],
    }


def keep(told: dict[str, Any]) -> None:
    """Write figures beside those that stand there already."""
    file = ROOT / "benchmarks" / "results" / "bench_lerobot.json"
    before = json.loads(file.read_text()) if file.exists() else {}
    file.write_text(json.dumps(before | told, indent=1) + "\n")


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--two-arms", type=float, metavar="MINUTES", help="nothing but that")
    parser.add_argument("--only", action="append", help="which parts, by name")
    asked = parser.parse_args()
    if asked.two_arms:
        with tempfile.TemporaryDirectory() as folder:
            told = {"two_arms": two_arms(Path(folder), asked.two_arms)}
        print(json.dumps(told, indent=1))
        keep(told)
        return
    logging.disable(logging.WARNING)
    rows = recording()
    told = {}
    rules = ("travel", "limits", "distance", "seed", "stop", "motion", "command")
    parts: dict[str, Callable[[Path], dict[str, Any]]] = {
        "plugin": lambda folder: measured(rows, replayed_by_plugin(folder, rows)),
        "as_stock": lambda folder: measured(rows, replayed_as_stock(folder, rows)),
        "latency": latency,
    }
    if has_lerobot():
        parts["stock"] = lambda folder: measured(rows, replayed_by_stock(folder, rows))
    for name, run in parts.items():
        if asked.only and name not in asked.only:
            continue
        with tempfile.TemporaryDirectory() as folder, _referee.refereed(breaks=rules):
            told[name] = run(Path(folder))
        print(name, told[name], flush=True)
    keep(told)


if __name__ == "__main__":
    main()
