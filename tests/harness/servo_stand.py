"""A driver and its emulated servos on one thread, without waiting."""

import math

import numpy as np

from so101_motion.drivers.bus.ticks import JointMap
from so101_motion.drivers.feetech.feetech_arm import JOINTS, FeetechArm

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
