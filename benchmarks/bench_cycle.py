"""What a control cycle costs: CPU time of the I/O thread, on an emulated arm in real time.

The servos are emulated behind a pseudo-terminal by a process of their own, so their time does not
count; the time that the system needs to write and read does. Per cycle at 100 Hz: planned motions
of all joints, a slow one of a single joint, guarded following and jogging. At rest: the share of a
processor core.

``--before COMMIT`` measures that commit's code alternately with today's and adds the ratios, which
say more than the times: on a machine that has other work these change by half.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from itertools import cycle
from pathlib import Path

import numpy as np

from benchmarks import _common
from benchmarks.emulated_port import SUPPORT, emulated_port
from so101_motion.common.geometry import Array
from so101_motion.control.following import Following
from so101_motion.planning.goals import JointGoal
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.port_settings import ServoSettings
from so101_motion.rig.rig import Rig

HERE = Path(__file__).parents[1]
ENDS = np.radians(((-40.0, -50.0, 40.0, 30.0, -60.0), (40.0, -20.0, 10.0, 60.0, 60.0)))
SLOW = np.radians(((-10.0, -50.0, 40.0, 30.0, 0.0), (10.0, -50.0, 40.0, 30.0, 0.0)))
PACE = np.radians(10.0)
"""Of the slow motion [rad/s]."""
REST = "at rest [share of a core]"


class Meter:
    """The CPU time of the I/O thread, and its cycles."""

    def __init__(self, rig: Rig) -> None:
        (thread,) = (each for each in threading.enumerate() if each.name.startswith("so101-io"))
        assert thread.ident is not None
        self._clock, self._rig = time.pthread_getcpuclockid(thread.ident), rig
        self._used = self._cycles = 0.0

    def __enter__(self) -> Meter:
        self._cycles, self._end = 0.0, self._rig.executor.listen(self._count)
        self._used = time.clock_gettime(self._clock)
        return self

    def __exit__(self, *_: object) -> None:
        self._used = time.clock_gettime(self._clock) - self._used
        self._end()

    def _count(self, _: object) -> None:
        self._cycles += 1.0

    @property
    def per_cycle(self) -> float:
        """CPU time of a cycle [s]."""
        return self._used / self._cycles

    def share(self, seconds: float) -> float:
        """The share of a core that the thread takes while nobody asks for anything."""
        before = time.clock_gettime(self._clock)
        time.sleep(seconds)
        return (time.clock_gettime(self._clock) - before) / seconds


def measured(seconds: float) -> dict[str, float]:
    """Measure each for so many seconds."""
    found = {}
    with (
        emulated_port("--latency", "0.001", hand=SUPPORT) as port,
        open_hardware(ServoSettings(port=port, servo_ids=(1, 2, 3, 4, 5))) as rig,
    ):
        time.sleep(4.5)
        arm, meter = rig.arm, Meter(rig)
        follow, jog = (  # with the names of older commits
            getattr(arm, new, None) or getattr(arm, old)
            for new, old in (("follow", "open_following"), ("jog", "open_jog"))
        )

        def move(q: Array) -> None:
            rig.executor.execute(arm.plan(JointGoal(q=q)).trajectory).result()

        move(ENDS[0])
        time.sleep(3.0)
        found[REST] = meter.share(seconds)
        for name, ends, pace in (("planned", ENDS, None), ("slow, one joint", SLOW, PACE)):
            if pace is not None:
                move(ends[0])
                arm.set_speed(pace)
            end = time.monotonic() + seconds
            with meter:
                for goal in cycle(ends[::-1]):
                    move(goal)
                    if time.monotonic() > end:
                        break
            found[f"{name} [s]"] = meter.per_cycle
        arm.set_speed(np.radians(50.0))
        move(ENDS[0])
        targets = _weaving(ENDS[0])
        following = follow(each=lambda following: _aim(targets, following))
        with meter:
            time.sleep(seconds)
        following.close().result()
        found["guarded following [s]"] = meter.per_cycle
        move(np.radians((0.0, -40.0, 30.0, 40.0, 0.0)))
        jogging = jog()
        with meter:
            for k in range(round(seconds / 0.05)):
                turn = 0.05 * k * np.pi
                jogging.twist((0.03 * np.cos(turn), 0.05 * np.sin(turn), 0.03 * np.sin(turn)))
                time.sleep(0.05)
        jogging.close().result()
        found["jogging [s]"] = meter.per_cycle
    return found


def _weaving(q: Array) -> Iterator[Array]:
    for k in range(1_000_000):
        t = 0.01 * k
        yield q + np.radians(15.0) * (1.0 - np.cos(t * np.array((1.0, 1.3, 0.9, 1.7, 2.1))))


def _aim(targets: Iterator[Array], following: Following) -> None:
    following.aim(next(targets))


def alternating(seconds: float, rounds: int, commit: str | None) -> Iterator[dict[str, object]]:
    """A row for each kind of cycle: the median of ``rounds``, today's and the commit's."""
    with tempfile.TemporaryDirectory() as name:
        checkouts = {"now": HERE}
        if commit is not None:
            checkouts["before"] = before = Path(name)
            tree = subprocess.run(["git", "archive", commit], cwd=HERE, check=True, stdout=-1)
            subprocess.run(["tar", "x"], cwd=before, input=tree.stdout, check=True)
            subprocess.run([sys.executable, "build_native.py"], cwd=before, check=True, stdout=-1)
            (before / "benchmarks" / Path(__file__).name).write_bytes(Path(__file__).read_bytes())
        runs: dict[str, list[dict[str, float]]] = {who: [] for who in checkouts}
        for _ in range(rounds):
            for who, checkout in checkouts.items():
                command = [sys.executable, "-m", "benchmarks.bench_cycle", "--once"]
                own = {**os.environ, "PYTHONPATH": str(checkout)}  # its planning process, too
                done = subprocess.run(
                    [*command, str(seconds)],
                    cwd=checkout,
                    env=own,
                    check=True,
                    stdout=-1,
                    text=True,
                )
                runs[who].append(json.loads(done.stdout.splitlines()[-1]))
        for what in runs["now"][0]:
            row = {
                who: float(np.median([each[what] for each in many])) for who, many in runs.items()
            }
            yield {"what": what, **row, "ratio": row["now"] / row.get("before", row["now"])}


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--seconds", type=float, default=8.0, help="of each kind of cycle")
    arguments.add_argument("--rounds", type=int, default=3)
    arguments.add_argument("--before", metavar="COMMIT", help="measure its code alternately")
    arguments.add_argument("--once", type=float, metavar="SECONDS", help=argparse.SUPPRESS)
    given = arguments.parse_args()
    if given.once:
        print(json.dumps(measured(given.once)))
        return
    rows = list(alternating(given.seconds, given.rounds, given.before))
    _common.write("bench_cycle", rows)


if __name__ == "__main__":
    main()
