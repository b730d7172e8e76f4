"""A bench for tests: emulated servos on a wire, and a clock moved by hand. No port, no waiting."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.bus import Bus
from so101_motion.drivers.emulator.codec import Code, frame
from so101_motion.drivers.emulator.emulator import EmulatorOptions, build_world
from so101_motion.drivers.emulator.faults import WireFaults
from so101_motion.drivers.emulator.world import World


@dataclass(frozen=True)
class Status:
    """A status packet as a client reads it."""

    servo_id: int
    error: int
    data: bytes


def statuses(data):
    """Split well-formed status packets; anything else fails the test."""
    found = []
    while data:
        assert data[:2] == b"\xff\xff", data.hex(" ")
        body, data = data[2 : 3 + data[3]], data[4 + data[3] :] if data[3] else b""
        found.append(Status(servo_id=body[0], error=body[2], data=bytes(body[3:])))
    return found


@dataclass
class Bench:
    world: World
    bus: Bus
    t: float = 0.0
    sent: list[bytes] = field(default_factory=list)

    def advance(self, dt):
        self.t += dt
        self.world.advance(self.t)

    def raw(self, data, **line):
        return self.bus.feed(data, self.t, **line)

    def ask(self, servo_id, code, params=b""):
        """The status packets an instruction draws."""
        replies = self.raw(frame(servo_id, code, params))
        return [status for reply in replies for status in statuses(reply.data)]

    def ask_one(self, servo_id, code, params=b""):
        (status,) = self.ask(servo_id, code, params)
        return status

    def write(self, servo_id, row, value):
        """Write one register; the status byte of the acknowledgement."""
        data = row.encode(value).to_bytes(row.size, "little")
        return self.ask_one(servo_id, Code.WRITE, bytes((row.address,)) + data).error

    def read(self, servo_id, row):
        data = self.ask_one(servo_id, Code.READ, bytes((row.address, row.size))).data
        return row.decode(int.from_bytes(data, "little"))

    def error_deg(self, servo_id):
        """Goal minus position [deg], as a client sees it."""
        ticks = self.read(servo_id, reg.GOAL_POSITION) - self.read(servo_id, reg.PRESENT_POSITION)
        return ticks * 360.0 / 4096.0


@pytest.fixture
def make_bench():
    def make(*, gravity=None, wire=None, **options):
        settings = {} if gravity is None else {"gravity": gravity}
        world = build_world(EmulatorOptions(**options), **settings)
        return Bench(world=world, bus=Bus(world, wire or WireFaults()))

    return make


@pytest.fixture
def bench(make_bench):
    """A finished arm at its zero, without weight."""
    return make_bench()


@pytest.fixture
def raised_arm():
    """Gravity of an arm with 100 g in its hand, stretched out and raised at shoulder_lift = 0.

    1.265 N m is the largest torque at the shoulder with that load; positive angles lower the arm.
    """

    def gravity(q):
        torque = np.zeros(6)
        torque[1] = -1.265 * math.cos(math.radians(62.0) - q[1])
        return torque

    return gravity


@pytest.fixture
def constant_load():
    """Makes gravity that asks for the same torques [N m] everywhere, by joint index."""

    def make(**torques):
        wanted = np.array([torques.get(f"j{number}", 0.0) for number in range(1, 7)])
        return lambda q: wanted

    return make
