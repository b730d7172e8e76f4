"""An emulated arm in a process of its own that notes what arrives on its wire, and when.

The notes are taken on the emulator's side of the pseudo-terminal, and read by a parser that shares
no code with the driver (``tests/referee/packets.py``). Times are those of ``CLOCK_MONOTONIC``,
which is one clock for all processes of a machine. They are written when the process is told to end,
so that writing disturbs nobody. The process keeps on time as the module does (``reduce_jitter``):
real servos do not wait for the processor of the program that drives them.

    python -m benchmarks.observed_wire NOTES HAND
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks import _common

GOAL = 42
"""Address of the goal position."""

LATENCY = 0.001
"""How long the emulated adapter holds replies [s]."""


class Goals(NamedTuple):
    """Goals that arrived at once: one packet, or several that the terminal had held back.

    Attributes:
        t: When, on ``CLOCK_MONOTONIC`` [s].
        packets: The goal of each servo [tick], by its id, for each packet.
    """

    t: float
    packets: list[dict[int, int]]


class ObservedWire:
    """An emulated arm on a pseudo-terminal; ``observed_wire`` makes it.

    Attributes:
        port: The port's name.
    """

    def __init__(self, port: str, notes: Path) -> None:
        self.port, self._notes = port, notes

    @property
    def goals(self) -> list[Goals]:
        """All goals, once the process has ended."""
        rows = (line.split() for line in self._notes.read_text().splitlines())
        return goals_in((float(t), bytes.fromhex(data)) for t, data in rows)


def goals_in(chunks: Iterable[tuple[float, bytes]]) -> list[Goals]:
    """The goals in what was written, chunk by chunk, and when [s]."""
    writes: Any = _common.from_tests("referee.packets").Writes()
    found = []
    for t, data in chunks:
        packets: list[dict[int, int]] = []
        for written in writes.feed(data):
            ticks = written.value(GOAL, 2)
            if ticks is None:
                continue
            if not packets or written.servo_id in packets[-1]:
                packets.append({})
            packets[-1][written.servo_id] = ticks
        if packets:
            found.append(Goals(t, packets))
    return found


@contextmanager
def observed_wire(folder: Path, name: str, hand: str) -> Iterator[ObservedWire]:
    """Run an emulated arm until the block ends; its goals can be read after that."""
    notes, script = folder / f"{name}.notes", folder / f"{name}.hand"
    script.write_text(hand)
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.observed_wire", str(notes), str(script)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        yield ObservedWire(process.stdout.readline().strip(), notes)
    finally:
        process.terminate()
        process.wait()


def main() -> None:
    """Emulate an arm until terminated; then write the notes."""
    from so101_motion.common.realtime import reduce_jitter
    from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
    from so101_motion.drivers.emulator.pty_port import Pacing
    from so101_motion.drivers.emulator.run import run_emulator
    from so101_motion.planning.kinematics.model import RobotModel

    reduce_jitter()
    notes, hand = map(Path, sys.argv[1:])
    seen: list[tuple[float, bytes]] = []
    Emulator.on_open.append(
        lambda emulator: emulator.bus.observers.append(lambda t, data: seen.append((t, data)))
    )
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    run_emulator(
        EmulatorOptions(hand=hand.read_text(), pacing=Pacing(realtime=True, latency=LATENCY)),
        announce=lambda text: print(text, flush=True),
        stop=stop,
        gravity=RobotModel.load().gravity_torque,
    )
    notes.write_text("".join(f"{t!r} {data.hex()}\n" for t, data in seen))


if __name__ == "__main__":
    main()
