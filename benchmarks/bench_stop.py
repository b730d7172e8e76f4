"""How soon an arm slows down after Stop has reached the module, while other clients load it.

The real module process, with an arm of emulated servos on a serial port (their own process, the
wire's time at 1 Mbaud, an adapter with 1 ms latency). Again and again the arm is sent to the other
side, and stopped at full speed. Two moments are noted on the same clock. *Arrival*: the last frame
of the Stop request has been handed to the kernel, on a connection of its own. *Slower*: the first
setpoint whose commanded velocity is below that of the cruise has been handed to the port; a
wrapper in the module's process notes every write. The time between them counts, in seconds and in
control cycles.

Meanwhile another process attacks the module: ``stop_attacks``.

Every row has its own module process. The processors are kept awake, because those of a virtual
machine wake up late. A witness on each processor runs at the highest priority: when it is late,
that processor stood still, and with it the module if the thread with the interpreter lock was
there. Stops meanwhile are in the figures, and counted apart.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
from grpclib.client import Channel
from viam.components.arm import JointPositions
from viam.components.arm.client import ArmClient

from benchmarks import _common
from benchmarks._machine import awake, witnessed
from benchmarks.bench_stream import LATENCY, PERIOD
from benchmarks.bench_stream import _parent as parent
from benchmarks.stop_attacks import ARM, ATTACKS, PLANNER, Target
from so101_motion.common.geometry import Array

STOPS = 1020  # a few do not count: the arm was not at full speed yet
SEED = 6
SPEED_DEG = 20.0
MIDDLE_DEG, ASIDE_DEG = -20.0, 50.0  # where the first joint swings
LIFTED_DEG = (-45.0, 45.0, 60.0, 0.0)
MOTION_MODEL = "devrel:so101:motion"

SERVOS = 3
"""Real-time priority of the emulated servos; the module's are 1 and 2."""

P99_CYCLES = 2.0
MAX_CYCLES = 10.0

_port: Any = _common.from_tests("harness.emulated_port")  # beside the parent
_RECORD = "SO101_BENCH_RECORD"


# The module's process


def module() -> None:
    """Be the module; note when each setpoint is written, and how fast the first joint shall go."""
    from so101_motion.__main__ import main as serve
    from so101_motion.drivers.feetech.feetech_arm import FeetechArm

    written: list[tuple[float, float]] = []
    write = FeetechArm.write

    def noted(
        self: FeetechArm,
        q_cmd: Array,
        q_jaw_cmd: float,
        qd_cmd: Array | None = None,
        qdd_cmd: Array | None = None,
        follows_target: bool = False,
        room: float = 0.0,
    ) -> None:
        write(self, q_cmd, q_jaw_cmd, qd_cmd, qdd_cmd, follows_target, room)
        written.append((time.monotonic(), 0.0 if qd_cmd is None else float(qd_cmd[0])))

    FeetechArm.write = noted  # type: ignore[method-assign]
    try:
        serve()
    finally:
        Path(os.environ[_RECORD]).write_text(json.dumps(written))


# The attacker


@contextlib.asynccontextmanager
async def attacked(name: str, target: Target) -> AsyncIterator[None]:
    """Have an attacker in a process of its own."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "benchmarks.stop_attacks", name, target.socket, str(target.pid),
        stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout is not None
    await process.stdout.readline()
    await asyncio.sleep(1.0)
    try:
        yield
        if process.returncode is not None:
            raise RuntimeError(f"the attacker gave up: {name}")
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        try:
            await asyncio.wait_for(process.wait(), 5.0)
        except TimeoutError:
            process.kill()
            await process.wait()


# The client that stops


class Stopper:
    """A client that knows when its request has arrived.

    Args:
        channel: Its own connection.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel, self._sent = channel, 0.0
        self.arm = ArmClient("arm", channel)

    async def prepare(self) -> None:
        """Note every write to the socket from now on."""
        protocol = await self._channel.__connect__()
        transport: Any = protocol.connection._transport
        write = transport.write

        def noted(data: bytes) -> None:
            write(data)
            if _ends_a_request(data):
                self._sent = time.monotonic()

        transport.write = noted

    async def stop(self) -> float:
        """Stop the arm; when the request had arrived [s]."""
        await self.arm.stop()
        return self._sent


def _ends_a_request(data: bytes) -> bool:
    """Whether an HTTP/2 DATA frame is among ``data`` that is the last of its stream (RFC 9113)."""
    while len(data) >= 9:
        if data[3] == 0 and data[4] & 1:
            return True
        data = data[9 + int.from_bytes(data[:3], "big") :]
    return False


def _like_hardware(pid: int) -> None:
    """Give the process of the emulated servos priority: real servos wait for no processor."""
    with contextlib.suppress(PermissionError):
        for thread in os.listdir(f"/proc/{pid}/task"):
            os.sched_setscheduler(int(thread), os.SCHED_FIFO, os.sched_param(SERVOS))


async def stops(name: str, n: int, record: Path) -> list[float]:
    """Stop the arm ``n`` times under an attack; when each request arrived [s]."""
    command = (sys.executable, "-m", "benchmarks.bench_stop", "--module")
    os.environ[_RECORD] = str(record)
    async with (
        _port.emulated_port(record.parent, "--latency", str(LATENCY)) as servos,
        parent.running_module(command=command) as (running, _, _),
    ):
        _like_hardware(servos.process.pid)
        fast = {"speed_degs_per_sec": SPEED_DEG, "acceleration_degs_per_sec_per_sec": 500.0}
        await running.add(parent.ARM, parent.HARDWARE_ARM, {"port": servos.port, **fast}, "arm")
        await running.add(parent.MOTION, MOTION_MODEL, {"arm": "arm"}, "planner")
        other, planner = ARM, PLANNER
        await running.add(parent.ARM, parent.SIMULATED, {}, other)
        await running.add(parent.MOTION, MOTION_MODEL, {"arm": other}, planner)
        target = Target(socket=str(running.socket), pid=running.process.pid)
        with target.connected() as channel:
            stopper = Stopper(channel)
            await stopper.prepare()

            async def holds() -> bool:
                return (await stopper.arm.get_status())["state"] == "holding"

            await parent.until(holds)
            await servos.let_go()
            await asyncio.sleep(2.0)  # the weight is taken up
            await stopper.arm.move_to_joint_positions(_pan(MIDDLE_DEG))
            async with attacked(name, target):
                return [moment async for moment in _stopped(stopper, n)]


async def _stopped(stopper: Stopper, n: int) -> AsyncIterator[float]:
    rng = np.random.default_rng(SEED)
    side = 1.0
    while n > 0:
        here = (await stopper.arm.get_joint_positions()).values[0]
        if side * (here - MIDDLE_DEG) > ASIDE_DEG - 45.0:
            side = -side
        goal = _pan(MIDDLE_DEG + side * ASIDE_DEG)
        await stopper.arm.move_to_joint_positions(goal, extra={"wait": False})
        await asyncio.sleep(0.13 + rng.uniform(0.0, 0.03))  # at full speed since 0.1 s
        yield await stopper.stop()
        n -= 1


def _pan(degrees: float) -> JointPositions:
    return JointPositions(values=[degrees, *LIFTED_DEG])


# The figures


def delays(arrivals: list[float], written: Array) -> list[tuple[float, float]]:
    """Each arrival and how long it took to the first slower setpoint [s].

    Args:
        arrivals: When Stop arrived [s].
        written: When each setpoint was written [s], and its velocity [rad/s].
    """
    t, speed = written[:, 0], np.abs(written[:, 1])
    found = []
    for arrival in arrivals:
        before = int(np.searchsorted(t, arrival)) - 1
        cruise = speed[before]
        if cruise < 0.9 * np.radians(SPEED_DEG):
            continue  # the attack kept the arm from its full speed; it does not count
        slower = before + 1 + int(np.argmax(speed[before + 1 :] < cruise * (1.0 - 1e-9)))
        found.append((arrival, t[slower] - arrival))
    return found


def row(name: str, n: int) -> dict[str, Any]:
    """One line of the table."""
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "record.json"
        with awake(), witnessed() as standstills:
            arrivals = asyncio.run(stops(name, n, record))
        written = np.array(json.loads(record.read_text()))
    counted = delays(arrivals, written)
    took = np.array([delay for _, delay in counted])
    stood = np.array(
        [
            any(begin < arrival + delay and end > arrival for begin, end in standstills)
            for arrival, delay in counted
        ]
    )
    cycles, running = took / PERIOD, took[~stood] / PERIOD
    moves = written[:, 1] != 0.0
    late = (np.diff(written[:, 0]) - PERIOD)[moves[:-1] & moves[1:]]
    return {
        "meanwhile": name,
        **_common.summary(took),
        "p99 [cycles]": float(np.percentile(cycles, 99.0)),
        "max [cycles]": float(cycles.max()),
        "over 2 cycles": int(np.count_nonzero(cycles > P99_CYCLES)),
        "over 10 cycles": int(np.count_nonzero(cycles > MAX_CYCLES)),
        "a processor stood still": int(np.count_nonzero(stood)),
        "p99 of the others [cycles]": float(np.percentile(running, 99.0)),
        "max of the others [cycles]": float(running.max()),
        "setpoints late by over 2 ms [%]": 100.0 * float(np.mean(late > 2e-3)),
        "latest setpoint [ms]": 1e3 * float(late.max()),
        "bar": f"p99 {P99_CYCLES:g} cycles, never {MAX_CYCLES:g}",
    }


def main() -> None:
    """Measure, print and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=STOPS, help="stops for each row")
    parser.add_argument("--only", choices=ATTACKS, action="append", help="just these rows")
    parser.add_argument("--dry", action="store_true", help="print the table, write no results")
    wanted = parser.parse_args()
    _common.single_thread()
    rows = [row(name, wanted.n) for name in wanted.only or ATTACKS]
    if wanted.dry:
        _common.print_table("bench_stop", rows)
    else:
        _common.write("bench_stop", rows, peers=("feetech-servo-sdk", "pyserial", "grpclib"))


if __name__ == "__main__":
    if "--module" in sys.argv:
        sys.argv.remove("--module")
        module()
    else:
        main()
