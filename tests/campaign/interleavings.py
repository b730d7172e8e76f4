"""Requests to an arm in any order, and faults on its bus among them, on pretended time.

An emulated arm, the real driver and executor, one clock. An interleaving is some requests with
pauses between them, and a Stop at the end. Laws: every request ends, with success or with an error
of ours; after the Stop nothing moves; the referee objects to nothing.
"""

import math
import random
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from referee import STOP_JERK, CommandCaps, Referee

from so101_motion.common.clock import ManualClock
from so101_motion.common.compliance import Compliance
from so101_motion.common.errors import So101Error
from so101_motion.control.executor import Channel, Executor, Tolerances
from so101_motion.control.streamed_trajectory import Stream, TimedPoint
from so101_motion.drivers.bus.ticks import JointMap, Ticks
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.faults import FaultEvent
from so101_motion.drivers.emulator.hardware import SO101
from so101_motion.drivers.feetech import feetech_arm
from so101_motion.drivers.feetech.feetech_arm import JOINTS, FeetechArm
from so101_motion.drivers.port.serial_port import PortOpener
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits

MAPS = {
    each.name: JointMap(
        servo_id=i,
        lower_ticks=Ticks(max(math.ceil(2048 + each.lower * 4096 / math.tau), 0)),
        upper_ticks=Ticks(min(math.floor(2048 + each.upper * 4096 / math.tau), 4095)),
    )
    for i, each in enumerate(SO101, start=1)
}
"""The emulated joints from stop to stop."""

LIMITS = MotionLimits.uniform(velocity=0.87, acceleration=1.75, jerk=50.0)
JAW_LIMITS = MotionLimits.uniform(velocity=1.57, acceleration=10.0, jerk=200.0, n=1)
STOP_LIMITS = MotionLimits.uniform(velocity=math.pi, acceleration=8.7, jerk=200.0)
JAW_STOP_LIMITS = MotionLimits.uniform(velocity=3.84, acceleration=24.0, jerk=600.0, n=1)
CAPS = (
    *((CommandCaps(50.0, 101.0, STOP_JERK * math.degrees(200.0), braking=500.0),) * 5),
    CommandCaps(91.0, 574.0, STOP_JERK * math.degrees(600.0), braking=1376.0),
)
LONGEST = 20.0  # [s] of pretended time that a request may take after the Stop
_WIRE = ("loss", "request_loss", "corrupt", "duplicate")
_FAULTS = ("unplug", "dead", "reboot", "hot", "brownout")


class Arm:
    """An emulated arm that is asked at random.

    Args:
        seed: Of everything.
        faulty: Whether its bus and servos fail as well.
    """

    def __init__(self, seed, *, faulty=False):
        self.rng, self.faulty = random.Random(seed), faulty
        self.clock, self.referee = ManualClock(), Referee()
        self.done, self.broken = Counter(), []
        weight = RobotModel.load().gravity_torque
        self._folder = tempfile.TemporaryDirectory()
        self.emulator = Emulator(
            EmulatorOptions(link=Path(self._folder.name) / "arm"),
            now=self.clock.now,
            gravity=lambda q: 1.1 * weight(q),
        )
        self.match = self.referee.attend(self.emulator)
        driver = FeetechArm(
            PortOpener(self.emulator.port), self.clock, MAPS, gravity=weight,
            speed=math.pi, acceleration=10.0, reply_timeout=0.02,
        )  # fmt: skip
        driver.on_command = self.match.listen(
            lambda: CAPS, lambda i, q: MAPS[JOINTS[i]].to_ticks(q)
        )
        self.executor = Executor(
            driver,
            self.clock,
            dt=0.01,
            stop_limits=STOP_LIMITS,
            jaw_stop_limits=JAW_STOP_LIMITS,
            name="so101-io-campaign",
            tolerances=Tolerances(
                settle_position=feetech_arm.SETTLE_POSITION,
                settle_velocity=feetech_arm.SETTLE_VELOCITY,
                settle_timeout=feetech_arm.SETTLE_TIMEOUT,
            ),
        )
        self.executor.start()
        self.clock.advance(1.0)
        self._fault = None

    # Requests

    def _goal(self):
        return np.array([self.rng.uniform(-0.7, 0.7) for _ in range(5)])

    def _move(self):
        here = self.executor.state.q_ref
        return self.executor.execute(online.point_to_point(here, self._goal(), LIMITS, 0.01))

    def _retarget(self):
        return self.executor.retarget(self._goal(), LIMITS)

    def _jaw(self):
        goal = np.array([self.rng.uniform(0.1, 1.5)])
        return self.executor.retarget(goal, JAW_LIMITS, channel=Channel.JAW)

    def _stop(self):
        return self.executor.stop(self.rng.choice((None, Channel.ARM, Channel.JAW)))

    def _stream(self):
        stream = self.executor.play(
            Stream(q_start=self.executor.state.q_ref, limits=LIMITS, dt=0.01)
        )
        here, aside = self.executor.state.q_ref, self.rng.choice((-0.02, 0.02))
        stream.push([TimedPoint(t=0.1 * k, q=here + aside * k * k / 100.0) for k in range(9)])
        if self.rng.random() < 0.5:
            stream.finish()
        return stream.future

    def _manual(self):
        return self.executor.guide(Compliance())

    def _hold(self):
        return self.executor.hold()

    def _limp(self):
        return self.executor.release()

    def _reconfigure(self):
        return self.executor.call_and_rehold(lambda driver: None)

    def _disturb(self):
        """Begin or end a fault."""
        if self._fault is not None:
            self._heal()
        elif self.rng.random() < 0.5:
            for name in _WIRE:
                setattr(self.emulator.bus.faults, name, self.rng.choice((0.0, 0.05)))
        else:
            kind = self.rng.choice(_FAULTS)
            servo = str(self.rng.randint(1, 6)) if kind in ("dead", "reboot", "hot") else None
            value = {"hot": 75.0, "brownout": 3.0}.get(kind)
            self._fault = FaultEvent(kind=kind, servo=servo, value=value)
            self.emulator.begin(self._fault)
        return None

    def _heal(self):
        if self._fault is not None:
            self.emulator.end(self._fault)
            self._fault = None
        for name in _WIRE:
            setattr(self.emulator.bus.faults, name, 0.0)

    # Interleavings

    def interleave(self):
        """One of them; what it breaks goes to ``broken``."""
        rng, futures, said = self.rng, [], []
        asks = [
            self._move, self._move, self._retarget, self._retarget, self._jaw, self._stop,
            self._stream, self._manual, self._hold, self._limp, self._reconfigure,
        ]  # fmt: skip
        asks += [self._disturb] * 2 if self.faulty else []
        self.match.set_off()
        for _ in range(rng.randint(2, 7)):
            ask = rng.choice(asks)
            said.append(ask.__name__[1:])
            self.done[said[-1]] += 1
            try:
                futures.append(ask())
            except So101Error:
                pass
            except Exception as error:
                self._object(said, f"{type(error).__name__} when asked: {error}")
            self.clock.advance(rng.choice((0.0, 0.0, 0.01, 0.03, 0.1, 0.3)))
        if self.faulty and rng.random() < 0.5:
            self._heal()
        self._end([future for future in futures if future is not None], said)

    def _end(self, futures, said):
        futures.append(self.executor.stop())
        waited = 0.0
        while not all(future.done() for future in futures) and waited < LONGEST:
            self.clock.advance(0.05)
            waited += 0.05
        for future in futures:
            if not future.done():
                self._object(said, f"a request did not end within {LONGEST} s")
                continue
            error = future.exception(timeout=0)
            if error is not None and not isinstance(error, So101Error):
                self._object(said, f"{type(error).__name__}: {error}")
        self.match.stop_answered()
        self.clock.advance(0.1)
        for finding in self.referee.findings:
            self._object(said, str(finding))
        self.referee.findings.clear()

    def _object(self, said, what):
        self.broken.append(f"after {' '.join(said)}: {what}")

    def recover(self):
        """Come back to a held arm for the next one."""
        self._heal()
        self.clock.advance(2.0)
        self.executor.hold()
        self.clock.advance(0.5)

    def close(self):
        self._heal()
        self.executor.close()
        self.emulator.close()
        self._folder.cleanup()


def run(seed, *, count, faulty=False, each=50):
    """``count`` interleavings on arms that are made anew after some; done, seconds, broken laws."""
    done, seconds, broken = Counter(), 0.0, []
    for first in range(0, count, each):
        arm = Arm(f"{seed} {first}", faulty=faulty)
        try:
            for _ in range(min(each, count - first)):
                arm.interleave()
                is_held = arm.executor.state.mode.value in ("holding", "moving", "stopping")
                if not is_held and arm.rng.random() < 0.7:
                    arm.recover()
            broken += [f"seed {seed}, arm {first}: {text}" for text in arm.broken]
        finally:
            arm.close()
        done += arm.done
        seconds += arm.clock.now()
    return done, seconds, broken
