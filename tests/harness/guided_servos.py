"""A driver and emulated servos with weight, which a hand guides, on one thread without waiting."""

import math

import numpy as np

from so101_motion.common.clock import ManualClock
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.ticks import JointMap
from so101_motion.drivers.emulator.hand import STRENGTH, Hand, parse_script
from so101_motion.drivers.feetech.feetech_arm import JOINTS, FeetechArm
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.torque import gravity_per_kg

_MODEL = RobotModel.load()
WEIGHT, PER_KG = _MODEL.gravity_torque, gravity_per_kg(_MODEL)
POSE = (0.0, -0.5, 0.5, 0.0, 0.0, 0.3)
MAPS = {joint: JointMap(servo_id=i) for i, joint in enumerate(JOINTS, start=1)}


class FeelingHand(Hand):
    """A hand that remembers what it felt, from half a second after it took hold."""

    def __init__(self, script, t, strength=STRENGTH):
        super().__init__(parse_script(script), t, strength=strength)
        self.felt = []

    def torque(self, joint, t, q, qd):
        torque = super().torque(joint, t, q, qd)
        if joint in self._behind and t - self._start > 1.0:
            self.felt.append(abs(torque))
        return torque


class Guided:
    """An arm that holds, found by a driver."""

    def __init__(self, wired, *, heavier=1.0, q_start=POSE, gravity=WEIGHT, **options):
        self.clock, self._cycles = ManualClock(), 0
        self.port = wired(
            now=self.clock.now, gravity=lambda q: heavier * gravity(q), q_start=q_start, **options
        )
        self.arm = self.connect()

    def connect(self):
        arm = FeetechArm(
            lambda: self.port,
            self.clock,
            MAPS,
            gravity=WEIGHT,
            per_kg=PER_KG,
            speed=math.radians(220.0),
            acceleration=17.0,
            reply_timeout=0.0,
        )
        reading = arm.read()
        arm.write(reading.q, reading.q_jaw)
        arm.set_torque(True)
        self.arm = arm
        self.look(1.5)
        return arm

    @property
    def q_deg(self):
        self.port.world.advance(self.clock.now())
        return np.degrees(self.port.world.q)

    def look(self, seconds, dt=0.01, late=0.0):
        """Reads as the executor does; how far each joint got from where it was [deg].

        Args:
            seconds: How long.
            dt: How often.
            late: By how much every tenth cycle is late [s].
        """
        q_start, away, end = self.q_deg, np.zeros(6), self.clock.now() + seconds
        while self.clock.now() < end - 1e-9:
            self.arm.read()
            self._cycles += 1
            self.clock.advance(dt if self._cycles % 10 else dt + late)
            away = np.maximum(away, np.abs(self.q_deg - q_start))
        return away

    def hand(self, script, strength=STRENGTH):
        self.port.world.hand = hand = FeelingHand(script, self.clock.now(), strength)
        return hand

    def limits(self):
        return [self.port.memory(i, reg.TORQUE_LIMIT) for i in range(1, 7)]


def hand_leads(joint, start_deg, by_deg, seconds):
    """A hand that takes a joint after half a second, leads it, waits, lets go."""
    return (
        f"0.5 {joint} start\n"
        f"{0.5 + seconds} {joint} {start_deg + by_deg}\n"
        f"{1.0 + seconds} {joint} release\n"
    )
