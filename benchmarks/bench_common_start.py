"""How far apart two emulated arms begin a common motion, in real time, as seen on their wires.

Each arm is emulated in a process of its own, behind a pseudo-terminal; one program opens both with
the real driver, in one cell, and sends them to and fro together, both to the same angles, again and
again, at random moments. What counts is when the first changed goal of a motion comes out of each
terminal, noted by the emulators' processes and read by a parser of its own (``observed_wire.py``),
not what the program says of itself. At rest goals are repeated every 50 ms and corrected by a tick
now and then, so the first changed goal is the first one from which on they come every 10 ms. All
joints go far: then goals, which are sent ahead, change by a tick at least in the very first cycle.

Twice: in a plain program, and in one that keeps its threads on time as the module does
(``reduce_jitter``). A terminal hands bytes over when the kernel finds the time. Where it handed
over several packets at once as a motion began, nobody can tell when they were sent: such motions
are counted, but not among the differences. What the terminals add can be told by the rows ``before
the terminals``: the same goals as they were handed to them. Motions that ended early because servos
did not answer are counted; on a busy machine that is the terminal, too. It wants an idle machine,
three minutes.

    python -m benchmarks.bench_common_start --motions 40
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, suppress
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import _common
from benchmarks.emulated_port import SUPPORT
from benchmarks.observed_wire import Goals, goals_in, observed_wire
from so101_motion.arm.cell import Cell
from so101_motion.common.errors import So101Error
from so101_motion.common.geometry import SE3
from so101_motion.common.realtime import reduce_jitter
from so101_motion.drivers.port.serial_port import PortOpener, SerialPort
from so101_motion.planning.goals import JointGoal
from so101_motion.rig.hardware_rig import HardwareRig, open_hardware
from so101_motion.rig.port_settings import ServoSettings

NAMES = ("left", "right")
BASES = (SE3.identity(), SE3.from_rpy((0.0, 0.0, np.pi), (0.9, 0.0, 0.0)))
"""Out of each other's reach, as in the test with a simulated clock."""

SERVOS = (1, 2, 3, 4, 5)
BAR = 0.005
NEAREST, FARTHEST = 0.2, 0.3
"""Goals of all joints are so far from zero, to either side in turn [rad]."""

IN_MOTION, CADENCE = 4, 0.06
"""So many goals in so long [s] come only in motion, not at rest."""


class Begun(NamedTuple):
    """The begin of a motion on a wire.

    Attributes:
        t: When [s].
        held_back: Whether several packets came at once then.
    """

    t: float
    held_back: bool


def begin_of(goals: Sequence[Goals], since: float) -> Begun | None:
    """When the first changed goal of a motion came out of a terminal after ``since`` [s]."""
    known: dict[int, int] = {}
    for k, each in enumerate(goals):
        for packet in each.packets:
            arm = {servo_id: packet[servo_id] for servo_id in SERVOS if servo_id in packet}
            changed, known = known and {**known, **arm} != known, {**known, **arm}
            if each.t < since or not changed:
                continue
            after = [later for later in goals[k + 1 :] if later.t <= each.t + CADENCE]
            if sum(len(later.packets) for later in after) >= IN_MOTION:
                late = any(len(later.packets) > 1 for later in (each, *after))
                return Begun(each.t, late)
    return None


def started(motions: int, seed: int, *, on_time: bool) -> list[dict[str, object]]:
    """Begin so many common motions; how far apart they began."""
    if on_time:
        reduce_jitter()
    random, asked, early = np.random.default_rng(seed), [], 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with ExitStack() as stack:
            wires = [stack.enter_context(observed_wire(folder, each, SUPPORT)) for each in NAMES]
            sent: list[list[tuple[float, bytes]]] = [[] for _ in wires]
            rigs = [
                _opened(stack, wire.port, notes) for wire, notes in zip(wires, sent, strict=True)
            ]
            time.sleep(5.0)  # the hand lets go
            cell = Cell()
            for each, rig, T in zip(NAMES, rigs, BASES, strict=True):
                cell.add(each, rig, T)
            for k in range(motions):
                time.sleep(0.6 + random.uniform(0.0, 0.1))
                goal = JointGoal(q=np.full(5, (-1) ** k * random.uniform(NEAREST, FARTHEST)))
                goals = dict.fromkeys(NAMES, goal)
                asked.append(time.monotonic())
                early += _ended_early(cell, goals)
                for rig in rigs:
                    _recover(rig)
        seen = [wire.goals for wire in wires]
    what = "a program that keeps on time" if on_time else "a plain program"
    common = {"ended early": early, "load of the machine": os.getloadavg()[0]}
    return [
        {"what": f"{what}, on the wires", **_apart(asked, seen), **common},
        {"what": f"{what}, before the terminals", **_apart(asked, [*map(goals_in, sent)])},
    ]


def _apart(asked: Sequence[float], wires: Sequence[Sequence[Goals]]) -> dict[str, object]:
    """How far apart motions began that were asked for at these times."""
    apart, held_back, unseen = [], 0, 0
    for since, until in zip(asked, [*asked[1:], np.inf], strict=True):
        begun = [begin_of([each for each in goals if each.t < until], since) for goals in wires]
        one, other = begun
        if one is None or other is None:
            unseen += 1
        elif one.held_back or other.held_back:
            held_back += 1
        else:
            apart.append(abs(one.t - other.t))
    return {
        "motions": len(asked),
        **(_common.summary(apart) if apart else {"n": 0}),
        "over 5 ms": sum(each > BAR for each in apart),
        "held back by a terminal": held_back,
        "not begun": unseen,
    }


class _NotedPort(SerialPort):
    """A serial port that notes what is written to it, and when."""

    def __init__(self, name: str, baud: int, *, notes: list[tuple[float, bytes]]) -> None:
        self._notes = notes
        super().__init__(name, baud)

    def write(self, data: bytes) -> None:
        self._notes.append((time.monotonic(), data))
        super().write(data)


def _opened(stack: ExitStack, port: str, notes: list[tuple[float, bytes]]) -> HardwareRig:
    settings = ServoSettings(port=port, servo_ids=SERVOS, gripper_id=6)
    opener = PortOpener(port, settings.baudrate, partial(_NotedPort, notes=notes))
    rig = open_hardware(settings, open_port=opener)
    stack.callback(rig.close)
    return rig


def _ended_early(cell: Cell, goals: dict[str, JointGoal]) -> bool:
    ended = False
    for motion in cell.start_together(goals).values():
        try:
            motion.result()
        except So101Error as error:
            print(error)
            ended = True
    return ended


def _recover(rig: HardwareRig) -> None:
    """Hold again after a fault."""
    for _ in range(10):
        if rig.arm.state.fault is None:
            return
        with suppress(So101Error):
            rig.arm.set_torque(True)
        time.sleep(0.5)


def main() -> None:
    """Measure, print and write the results."""
    _common.single_thread()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--motions", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    rows: list[dict[str, object]] = []
    for on_time in (False, True):
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            done = pool.submit(started, asked.motions, asked.seed, on_time=on_time)
            rows += done.result()
    _common.write("bench_common_start", [*rows, {"what": "bar", "max": BAR}])


if __name__ == "__main__":
    main()
