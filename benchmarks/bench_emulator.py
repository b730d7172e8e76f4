"""Processor time of an emulated arm in real time: at rest, held, and while all six servos move.

The emulator runs in a process of its own, as ``so101 emulate`` does. The driver holds or moves its
joints 100 times a second, as in ``bench_bus``, so physics, registers, protocol and pseudo-terminal
are all in the figure. The driver's own time is not.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np

from benchmarks import _common
from benchmarks.bench_bus import PERIOD, holding_arm
from benchmarks.emulated_port import SUPPORT, emulated_process
from so101_motion.drivers.port.serial_port import SerialPort

TURNS = 2.0
"""How fast the phase of the waving grows [rad/s]."""

REACH = 0.05
"""How far each joint waves to either side [rad]."""


def processor_time(pid: int) -> float:
    """Processor time of a process so far, in all its threads [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def share(seconds: float, *, reach: float, asks: bool) -> float:
    """Share of a core that the emulator takes.

    Args:
        seconds: For how long it is looked at.
        reach: How far the six joints wave [rad]; 0 holds them.
        asks: Whether goals are written and positions read 100 times a second.
    """
    with emulated_process(hand=SUPPORT) as (name, pid):
        arm = holding_arm(SerialPort(name))
        reading = arm.read()
        start, used, k = time.monotonic(), 0.0, 0
        for k in range(round((2.0 + seconds) / PERIOD)):
            time.sleep(max(0.0, start + k * PERIOD - time.monotonic()))
            t = time.monotonic() - start
            if t < 2.0:
                begin, used = time.monotonic(), processor_time(pid)
            if asks or t < 2.0:
                # A setpoint that is sent late must not ask for more than a servo can: t is true.
                way = reach * np.sin(TURNS * t)
                speed = np.full(5, reach * TURNS * np.cos(TURNS * t))
                arm.write(reading.q + way, reading.q_jaw + abs(way), speed)
                arm.read()
        found = (processor_time(pid) - used) / (time.monotonic() - begin)
        arm.set_torque(False)
        arm.close()
    return found


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="for each row")
    asked = parser.parse_args()
    rows = [
        {"what": what, "share of a core": share(asked.seconds, reach=reach, asks=asks), **more}
        for what, reach, asks, more in (
            ("at rest, held, nobody asks", 0.0, False, {}),
            ("at rest, held, 100 Hz", 0.0, True, {}),
            ("six servos move, 100 Hz", REACH, True, {"bar": 0.08}),
        )
    ]
    _common.write("bench_emulator", rows)


if __name__ == "__main__":
    main()
