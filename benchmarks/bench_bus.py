"""One control cycle of the arm on its bus: processor time, wire time, transactions.

The servos are emulated, in a process of their own behind a pseudo-terminal, with the time of the
wire at 1 Mbaud and an adapter that holds replies back for 1 ms. A cycle is one sync write of all
goals and one sync read of all positions, every tenth of a second a longer one; the driver's whole
cycle adds radians, velocities, the weight of the arm and the state of the servos. Processor time is
that of the thread that talks; what the kernel's pseudo-terminal does for us is in it, what a USB
stack would do is not. The vendor's own group read is measured beside ours.

The whole cycle is measured back to back, where it waits only for its answers, like the other rows,
and at 100 Hz, where it sleeps in between. A virtual machine gives sleeping processors away, and the
same instructions take several times as long when they come back. Two rows show that this explains
the difference: the same cycles without a port, with answers at once, differ as much; and there is
no difference while processes of idle priority keep the processors awake.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import numpy as np
import scservo_sdk

from benchmarks import _common
from benchmarks._machine import awake
from benchmarks.emulated_port import SUPPORT, emulated_port
from so101_motion.common.clock import MonotonicClock
from so101_motion.common.errors import NoReply
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus, Port
from so101_motion.drivers.bus.ticks import JointMap
from so101_motion.drivers.emulator.bus import Bus as EmulatedBus
from so101_motion.drivers.emulator.emulator import EmulatorOptions, build_world
from so101_motion.drivers.feetech.feetech_arm import JOINTS, FeetechArm
from so101_motion.drivers.port.serial_port import SerialPort
from so101_motion.planning.kinematics.model import RobotModel

CYCLES = 1000
PERIOD = 0.01
WIRE = ("--latency", "0.001")
IDS = tuple(range(1, 7))
MAPS = {joint: JointMap(servo_id=servo_id) for servo_id, joint in zip(IDS, JOINTS, strict=True)}

LEAST_BYTES = 26 + 14 + 6 * (2 + 9)
"""Bytes of a cycle: goals out, question out, six slots of two bytes, headers and a gap."""


class CountingPort:
    """A port that counts transactions and bytes."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self.transactions = self.wire_bytes = 0

    @property
    def name(self) -> str:
        """As the port's."""
        return self._port.name

    @property
    def baud(self) -> int:
        """As the port's."""
        return self._port.baud

    def write(self, data: bytes) -> None:
        """Send, and count the packet with the slots it reserves for answers."""
        self.transactions += 1
        self.wire_bytes += len(data)
        if data[4] == scservo_sdk.INST_SYNC_READ:
            self.wire_bytes += (len(data) - 8) * (data[6] + 9)
        self._port.write(data)

    def read(self, until: float) -> bytes:
        """As the port's."""
        return self._port.read(until)

    def discard(self) -> None:
        """As the port's."""
        self._port.discard()

    def close(self) -> None:
        """As the port's."""
        self._port.close()


class ReadyPort:
    """A stand-in for a port that answers every question at once, the second time from memory."""

    name, baud = "no port", 1_000_000

    def __init__(self) -> None:
        self._bus = EmulatedBus(build_world(EmulatorOptions(), t=time.monotonic()))
        self._known: dict[bytes, bytes] = {}
        self._answer = b""
        self.remembers = False

    def write(self, data: bytes) -> None:
        """Prepare the answer."""
        known = self._known.get(data) if self.remembers else None
        if known is None:
            if self.remembers and data[4] == scservo_sdk.INST_SYNC_WRITE:
                known = b""
            else:
                replies = self._bus.feed(data, time.monotonic())
                known = self._known[data] = b"".join(reply.data for reply in replies)
        self._answer = known

    def read(self, until: float) -> bytes:
        """All of the answer."""
        answer, self._answer = self._answer, b""
        return answer

    def discard(self) -> None:
        """Forget the answer."""
        self._answer = b""

    def close(self) -> None:
        """Do nothing."""


def timed(step: Callable[[int], object], *, period: float) -> tuple[list[float], list[float]]:
    """Processor and wall time [s] of each of the cycles, which come at their times."""
    cpu: list[float] = []
    wall: list[float] = []
    start = time.monotonic()
    for k in range(CYCLES):
        time.sleep(max(0.0, start + k * period - time.monotonic()))
        begin = time.perf_counter_ns(), time.thread_time_ns()
        step(k)
        cpu.append((time.thread_time_ns() - begin[1]) * 1e-9)
        wall.append((time.perf_counter_ns() - begin[0]) * 1e-9)
    return cpu, wall


def cycles(*options: str, period: float = PERIOD) -> tuple[list[float], list[float], CountingPort]:
    """Control cycles of an arm that waves a little."""
    with emulated_port(*WIRE, *options, hand=SUPPORT) as name:
        port = CountingPort(SerialPort(name))
        arm = holding_arm(port)
        port.transactions = port.wire_bytes = 0
        cpu, wall = timed(waving(arm), period=period)
        counted = port.transactions, port.wire_bytes
        arm.set_torque(False)
        arm.close()
    port.transactions, port.wire_bytes = counted
    return cpu, wall, port


def portless_cycles(*, period: float) -> list[float]:
    """Processor time of the same cycles with answers that are there at once."""
    port = ReadyPort()
    arm = holding_arm(port)
    port.remembers = True
    return timed(waving(arm), period=period)[0]


def holding_arm(port: Port) -> FeetechArm:
    """An arm with its torque on, some time after it was opened."""
    arm = FeetechArm(
        lambda: port,
        MonotonicClock(),
        MAPS,
        gravity=RobotModel.load().gravity_torque,
        speed=np.pi,
        acceleration=10.0,
    )
    reading = arm.read()
    arm.write(reading.q, reading.q_jaw)
    arm.set_torque(True)
    time.sleep(0.3)  # until no length is avoided any more
    arm.read()
    return arm


def waving(arm: FeetechArm) -> Callable[[int], None]:
    """A control cycle: the next setpoint and where the joints are.

    After a servo has died, which the driver raises once, the wave begins anew where the joints
    are: a driver that has lost a servo holds nothing it was told before.
    """
    reading = arm.read()
    arm.write(reading.q, reading.q_jaw)  # they have sunk since they were told to hold
    begin = time.monotonic()

    def cycle(_: int) -> None:
        nonlocal reading, begin
        t = time.monotonic() - begin  # so that no cycle asks for more than a servo can
        arm.write(
            reading.q + 0.05 * np.sin(2.0 * t), reading.q_jaw, np.full(5, 0.1 * np.cos(2.0 * t))
        )
        try:
            arm.read()
        except NoReply:
            reading = arm.read()
            arm.write(reading.q, reading.q_jaw)
            begin = time.monotonic()

    return cycle


def vendors_read() -> tuple[list[float], list[float]]:
    """The vendor's group read of the same six positions, with its own port handler."""
    with emulated_port(*WIRE) as name:
        handler = scservo_sdk.PortHandler(name)
        handler.openPort()
        row = reg.PRESENT_POSITION
        group = scservo_sdk.GroupSyncRead(
            handler, scservo_sdk.PacketHandler(0), row.address, row.size
        )
        for servo_id in IDS:
            group.addParam(servo_id)
        times = timed(lambda _: group.txRxPacket(), period=0.0)
        handler.closePort()
    return times


def bare_cycle(*, with_goals: bool) -> tuple[list[float], list[float]]:
    """Our sync read of the same, after a sync write of six goals or alone; no conversions."""
    with emulated_port(*WIRE) as name:
        bus = Bus(SerialPort(name))
        goal, position = reg.GOAL_POSITION, reg.PRESENT_POSITION
        goals = dict.fromkeys(IDS, goal.encode(2048))

        def cycle(_: int) -> None:
            if with_goals:
                bus.sync_write(goal.address, goals)
            bus.sync_read(IDS, position.address, position.size)

        times = timed(cycle, period=0.0)
        bus.close()
    return times


def main() -> None:
    """Measure, print and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dry", action="store_true", help="print the table, write no results")
    wanted = parser.parse_args()
    _common.single_thread()
    rows: list[dict[str, Any]] = []

    def add(what: str, times: list[float], **more: Any) -> None:
        rows.append({"what": what, **_common.summary(times), **more})

    cpu, wall = bare_cycle(with_goals=True)
    add("sync write and sync read, processor", cpu, bar="200 us")
    add("sync write and sync read, wall", wall)
    for rhythm, period, company in (
        ("back to back", 0.0, nullcontext()),
        ("at 100 Hz", PERIOD, nullcontext()),
        ("at 100 Hz, processors kept awake", PERIOD, awake()),
    ):
        with company:
            cpu, wall, port = cycles(period=period)
            portless = portless_cycles(period=period)
        add(f"the driver's whole cycle, {rhythm}, processor", cpu)
        add(f"the driver's whole cycle, {rhythm}, wall", wall)
        add(f"the same without a port, {rhythm}, processor", portless)
    cpu, wall = bare_cycle(with_goals=False)
    add("sync read of 6 positions, processor", cpu)
    cpu, wall = vendors_read()
    add("the vendor's sync read of the same, processor", cpu)
    rows.append({"what": "transactions a cycle", "value": port.transactions / CYCLES, "bar": "2"})
    rows.append(
        {
            "what": "wire bytes, of the least possible",
            "value": port.wire_bytes / CYCLES / LEAST_BYTES,
            "bar": "1.1",
        }
    )
    cpu, wall, _ = cycles("--fault", "dead:gripper@3")
    add("with a servo that dies on the way, at 100 Hz, processor", cpu)
    add("with a servo that dies on the way, at 100 Hz, wall", wall)
    if wanted.dry:
        _common.print_table("bench_bus", rows)
    else:
        _common.write("bench_bus", rows, peers=("feetech-servo-sdk", "pyserial"))


if __name__ == "__main__":
    main()
