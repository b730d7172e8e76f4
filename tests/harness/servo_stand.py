"""A driver and its emulated servos on one thread, without waiting, and a hand that guides them."""

import math

import numpy as np

from so101_motion.common.clock import ManualClock
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.ticks import JointMap
from so101_motion.drivers.emulator.hand import STRENGTH, Hand, parse_script
from so101_motion.drivers.feetech.feetech_arm import JOINTS, FeetechArm
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.shared_port import arm_weight

MAPS = {joint: JointMap(servo_id=i) for i, joint in enumerate(JOINTS, start=1)}
ELBOW, JAW = 3, 6
STEP = 0.03  # less than the caps allow in a cycle [rad]


def weightless(q):
    return np.zeros(6)


def heavy(q):
    """An outstretched arm with something in its hand."""
    return np.array([0.0, -0.9, -0.4, 0.0, 0.0, 0.0])


class Stand:
    """An arm on ``WiredPort``: servos, driver and clock, without a thread or a wait."""

    def __init__(self, clock, port):
        self.clock, self.port, self.arm = clock, port, None

    def connect(self, maps=None, gravity=weightless, **settings):
        caps = {"speed": math.radians(180.0), "acceleration": 10.0} | settings
        self.arm = FeetechArm(
            self.plug,
            self.clock,
            MAPS if maps is None else maps,
            gravity=gravity,
            reply_timeout=0.0,
            **caps,
        )
        return self.arm

    def plug(self):
        self.port.check()
        return self.port

    def memory(self, servo, row):
        self.port.world.advance(self.clock.now())
        return self.port.memory(servo, row)

    def torque(self):
        self.port.world.advance(self.clock.now())
        return [int(servo.drive.torque) for servo in self.port.world.servos]

    @property
    def q(self):
        self.port.world.advance(self.clock.now())
        return self.port.world.q

    def hold(self):
        self.seed()
        self.arm.set_torque(True)

    def seed(self):
        reading = self.arm.read()
        self.arm.write(reading.q, reading.q_jaw)
        self.sent = np.array([*reading.q, reading.q_jaw])

    def write(self, q_cmd, q_jaw_cmd):
        """Send the joints on towards a goal, as far as the caps allow in a cycle."""
        self.sent += np.clip([*q_cmd, q_jaw_cmd] - self.sent, -STEP, STEP)
        self.arm.write(self.sent[:5], self.sent[5])

    def follow(self, seconds, q_cmd=None, q_jaw_cmd=0.0):
        for _ in range(round(seconds / 0.01)):
            if q_cmd is not None:
                self.write(q_cmd, q_jaw_cmd)
            self.arm.read()
            self.clock.advance(0.01)
        return self.arm.read()

    def look(self, seconds, dt=0.05):
        """Reads on as the executor does with an arm in a fault; what was raised."""
        raised = []
        for _ in range(round(seconds / dt)):
            try:
                self.arm.read()
            except Exception as error:
                raised.append(error)
            self.clock.advance(dt)
        return raised


_MODEL = RobotModel.load()
WEIGHT = arm_weight(_MODEL)
POSE = (0.0, -0.5, 0.5, 0.0, 0.0, 0.3)


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


class Guided(Stand):
    """An arm that holds, found by a driver, and that a hand guides."""

    def __init__(self, wired, *, heavier=1.0, q_start=POSE, gravity=WEIGHT, **options):
        clock, self._cycles = ManualClock(), 0
        port = wired(
            now=clock.now, gravity=lambda q: heavier * gravity(q), q_start=q_start, **options
        )
        super().__init__(clock, port)
        self.connect()

    def connect(self):
        arm = super().connect(
            gravity=WEIGHT, per_kg=WEIGHT.per_kg, speed=math.radians(220.0), acceleration=17.0
        )
        self.hold()
        self.look(1.5)
        return arm

    @property
    def q_deg(self):
        return np.degrees(self.q)

    def look(self, seconds, dt=0.01, late=0.0):
        """Reads as the executor does; how far each joint got from where it was [deg].

        Every tenth cycle is ``late`` [s].
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
