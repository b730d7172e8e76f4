"""An arm on a wire: the real driver and executor, the emulated servos, and one clock for all.

The pseudo-terminal is real and so are its microseconds; everything slower follows the clock, which
a test moves by hand. Replies come at once unless a test asks for lateness. The emulated arm weighs
a fifth more than the driver believes.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from harness.clocks import SettledClock
from harness.emulated_joints import MAPS
from harness.heard_port import HeardEmulator
from referee import CommandCaps, match_of

from so101_motion.control.executor import Executor, Tolerances
from so101_motion.drivers.emulator.emulator import EmulatorOptions
from so101_motion.drivers.feetech import gravity_compensation
from so101_motion.drivers.feetech.feetech_arm import JOINTS, FeetechArm
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits

PATIENCE = 0.1
"""How long an answer is waited for, on the wall clock [s]: above what a busy machine mostly takes
to run the emulator's thread; every answer that does get lost costs a test as much."""

STOP_LIMITS = MotionLimits.uniform(velocity=math.pi, acceleration=8.7, jerk=200.0)


class TapedDriver:
    """The driver, and what passed through it.

    Attributes:
        tape: Commanded and true arm joint angles of every cycle.
    """

    def __init__(self, arm, world):
        self.arm, self.world = arm, world
        self.tape = []
        self._q_cmd = np.zeros(5)

    def read(self):
        reading = self.arm.read()
        self.tape.append((self._q_cmd, self.world.q[:5]))
        return reading

    def write(self, q_cmd, q_jaw_cmd, qd_cmd=None, qdd_cmd=None, follows_target=False):
        self._q_cmd = np.array(q_cmd)
        self.arm.write(q_cmd, q_jaw_cmd, qd_cmd, qdd_cmd, follows_target)

    def set_torque(self, on):
        self.arm.set_torque(on)

    def close(self):
        self.arm.close()

    def path_error(self):
        """Largest distance from the commanded path once the lag is taken out [rad], and the lag."""
        q_cmd, q = (np.array(column) for column in zip(*self.tape, strict=True))
        errors = [np.max(np.abs(q_cmd[: len(q_cmd) - k] - q[k:])) for k in range(30)]
        return float(min(errors)), 0.01 * int(np.argmin(errors))


@dataclass
class Bench:
    """An emulated arm, its driver and its executor.

    Attributes:
        clock: What time it is for all.
        emulator: The servos and the port.
        arm: The driver.
        driver: The same with a tape.
        executor: Moves it.
    """

    clock: SettledClock
    emulator: HeardEmulator
    arm: Any = None
    driver: Any = None
    executor: Any = None
    limits: MotionLimits = field(
        default_factory=lambda: MotionLimits.uniform(velocity=0.87, acceleration=1.75, jerk=50.0)
    )

    @property
    def world(self):
        return self.emulator.world

    @property
    def wire(self):
        """What goes wrong on the wire."""
        return self.emulator.bus.faults

    @property
    def state(self):
        return self.executor.state

    @property
    def q(self):
        """True arm joint angles, shape (5,), [rad]."""
        self.emulator.advance()
        return self.world.q[:5]

    def connect(self, gravity, reply_timeout):
        self.arm = FeetechArm(
            self.emulator.opener(),
            self.clock,
            MAPS,
            gravity=gravity,
            speed=math.pi,
            acceleration=10.0,
            reply_timeout=reply_timeout,
        )
        arm = CommandCaps(180.0, 600.0, math.degrees(200.0))
        jaw = CommandCaps(220.0, 1376.0, math.degrees(600.0))
        self.arm.on_command = match_of(self.emulator).listen(
            lambda: (*((arm,) * 5), jaw), lambda i, q: MAPS[JOINTS[i]].to_ticks(q)
        )
        self.driver = TapedDriver(self.arm, self.world)
        self.executor = Executor(
            self.driver,
            self.clock,
            dt=0.01,
            stop_limits=STOP_LIMITS,
            name="so101-io-test",
            tolerances=Tolerances(
                settle_position=gravity_compensation.SETTLE_POSITION,
                settle_velocity=gravity_compensation.SETTLE_VELOCITY,
                settle_timeout=gravity_compensation.SETTLE_TIMEOUT,
            ),
        )
        self.executor.requests.on_request = match_of(self.emulator).requested
        self.executor.start()

    def move(self, q_goal):
        """Start a straight move; its future."""
        trajectory = online.point_to_point(self.state.q_ref, np.array(q_goal), self.limits, 0.01)
        self.driver.tape.clear()
        return self.executor.execute(trajectory)

    def finish(self, future, at_most=10.0):
        """Let time pass until ``future`` is done; what it holds."""
        for _ in range(round(at_most / 0.05)):
            if future.done():
                break
            self.clock.advance(0.05)
        return future.result(timeout=0)

    def close(self):
        if self.executor is not None:
            self.executor.close()
        self.emulator.close()


@pytest.fixture(scope="session")
def weight():
    """The torque that holds the arm of the robot description."""
    return RobotModel.load().gravity_torque


@pytest.fixture
def clock():
    return SettledClock()


@pytest.fixture
def make_bench(clock, tmp_path, weight):
    benches = []

    def make(*, reply_timeout=PATIENCE, **options):
        emulator = HeardEmulator(
            EmulatorOptions(link=tmp_path / f"arm{len(benches)}", **options),
            now=clock.now,
            gravity=lambda q: 1.2 * weight(q),
        )
        bench = Bench(clock, emulator)
        benches.append(bench)
        bench.connect(weight, reply_timeout)
        clock.advance(1.0)  # torque came on where the arm was found; now it takes up its weight
        return bench

    yield make
    for bench in benches:
        bench.close()


@pytest.fixture
def bench(make_bench):
    """A calibrated arm at its zero, holding."""
    return make_bench()
