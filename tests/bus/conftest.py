"""An arm on a wire: the real driver, the emulated servos, and a clock both live by.

The pseudo-terminal is real and so are its microseconds; everything slower follows the clock, which
a test moves by hand. Replies come at once unless a test asks for lateness.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from so101_motion.clock import ManualClock
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.world import no_gravity
from so101_motion.drivers.feetech_arm import JOINTS, FeetechArm
from so101_motion.drivers.port import PortOpener
from so101_motion.drivers.ticks import JointMap

PATIENCE = 0.05
"""Above what a busy machine takes to run the emulator's thread [s]."""

MAPS = {joint: JointMap(servo_id=i) for i, joint in enumerate(JOINTS, start=1)}


@dataclass
class Bench:
    """An emulated arm and its driver.

    Attributes:
        clock: What time it is for both.
        emulator: The servos and the port.
        arm: The driver.
    """

    clock: ManualClock
    emulator: Emulator
    arm: Any = None

    @property
    def world(self):
        return self.emulator.world

    @property
    def q(self):
        """True joint angles, shape (6,), [rad]."""
        self.emulator.advance()
        return self.world.q

    def memory(self, servo, row):
        """What a register of the emulated servo holds."""
        self.emulator.advance()
        return self.world.servo(servo).memory.value(row)

    def connect(self, maps=None, **settings):
        settings = {
            "gravity": no_gravity,
            "speed": math.radians(180),
            "acceleration": 10.0,
            **settings,
        }
        self.arm = FeetechArm(
            PortOpener(self.emulator.port),
            self.clock,
            MAPS if maps is None else maps,
            patience=PATIENCE,
            **settings,
        )
        return self.arm

    def hold(self):
        """What the executor does to let the joints hold where they are."""
        reading = self.arm.read()
        self.arm.write(reading.q, reading.q_jaw)
        self.arm.set_torque(True)

    def cycles(self, count, q_cmd=None, q_jaw_cmd=0.0, dt=0.01):
        """Control cycles; the readings."""
        readings = []
        for _ in range(count):
            if q_cmd is not None:
                self.arm.write(np.asarray(q_cmd, dtype=float), q_jaw_cmd)
            readings.append(self.arm.read())
            self.clock.advance(dt)
        return readings

    def errors(self, count, dt=0.05):
        """Reads that may fail; what they raised."""
        raised = []
        for _ in range(count):
            try:
                self.arm.read()
            except Exception as error:
                raised.append(error)
            self.clock.advance(dt)
        return raised


@pytest.fixture
def make_bench(clock, tmp_path):
    benches = []

    def make(*, gravity=no_gravity, connect=True, **options):
        link = tmp_path / f"arm{len(benches)}"
        emulator = Emulator(EmulatorOptions(link=link, **options), now=clock.now, gravity=gravity)
        bench = Bench(clock, emulator)
        benches.append(bench)
        if connect:
            bench.connect()
        return bench

    yield make
    for bench in benches:
        if bench.arm is not None:
            bench.arm.close()
        bench.emulator.close()


@pytest.fixture
def bench(make_bench):
    """A calibrated arm at its zero, without weight, found and limp."""
    return make_bench()


@pytest.fixture
def raised_arm():
    """Gravity of an arm with 100 g in its hand, stretched out and raised at shoulder_lift = 0."""

    def gravity(q):
        torque = np.zeros(6)
        torque[1] = -1.265 * math.cos(math.radians(62.0) - q[1])
        torque[2] = -0.5 * math.cos(math.radians(62.0) - q[1] - q[2])
        return torque

    return gravity
