"""Arms whose servos somebody has spoilt, and the truth about them: whether they then move well.

That is not our opinion: the driver opens the arm, as the rig does, leads it to where it is
stretched out, holds it there and leads it back, against its true angles. Simulated time.
"""

import math
from unittest import mock

import numpy as np

from harness.lent_bus import LentBus
from so101_motion.calib.motors import chain_check
from so101_motion.calib.motors.single_servo import Tuner
from so101_motion.calib.record.record import JOINTS
from so101_motion.common.errors import So101Error
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.emulator import registers as emulated
from so101_motion.drivers.feetech import servo_setup
from so101_motion.drivers.feetech.feetech_arm import FeetechArm
from so101_motion.drivers.feetech.servo_judgement import alarms
from so101_motion.drivers.servo_types import STS3215_12V
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.joint_setup import find_joints
from so101_motion.rig.port_settings import ServoSettings
from so101_motion.rig.servo_driver import ACCELERATION_CAP, SPEED_CAP
from so101_motion.setup.checkup import Findings, check_up, is_healthy

WEIGHT = RobotModel.load().gravity_torque
START = np.radians([0.0, 25.0, -25.0, 0.0, 0.0, 20.0])  # to be stretched out at the end
WAY = np.radians([20.0, 30.0, -30.0, 25.0, 25.0, 10.0])
MOVING, HOLDING = 1.5, 2.6  # [s]; a servo lets go of an overload after 2 s
CYCLE = 0.02  # [s]; half as often as the rig does, which is quicker and harder for the servos


def spoilt(*changes, kind=STS3215_12V, volts=None, **options):
    """An arm of which some servos hold other values: (place, register, raw value)."""
    bus = LentBus(q_start=tuple(START), kind=kind, volts=volts, **options)
    for place, name, value in changes:
        bus.world.servo(str(place)).memory.keep(getattr(emulated, name), value)
    bus.settle()
    for servo in bus.world.servos:
        servo.boot()
    bus.world.gravity = WEIGHT
    return bus


def doctor_lets_it_move(bus):
    with Tuner(bus) as tuner:
        return is_healthy(check_up(Findings(port="/dev/x", servos=chain_check.verify(tuner))))


def trouble_with_moving(bus):
    """What goes wrong when the arm is opened, held and moved; empty if nothing does."""
    clock, world = bus.clock, bus.world

    def true_angles():
        world.advance(clock.now())
        return np.array(world.q)

    try:
        found = find_joints(
            Bus(bus.wire, reply_timeout=0.0), ServoSettings(port="/dev/x"), JOINTS[:5]
        )
        arm = FeetechArm(
            lambda: bus.wire, clock, {joint: each.map for joint, each in found.setups.items()},
            gravity=WEIGHT, speed=SPEED_CAP, acceleration=ACCELERATION_CAP, reply_timeout=0.0,
        )  # fmt: skip
        driven = [i for i, joint in enumerate(JOINTS) if joint in found.setups]
        reading = arm.read()
        first = np.array([*reading.q, reading.q_jaw])
        arm.write(reading.q, reading.q_jaw)
        arm.set_torque(True)
        was = began = true_angles()
        fastest, worst = 0.0, 0.0
        for step in range(round((2 * MOVING + HOLDING) / CYCLE)):
            t = step * CYCLE
            s = min(t / MOVING, 1.0) - max((t - MOVING - HOLDING) / MOVING, 0.0)
            q = first + (10 * s**3 - 15 * s**4 + 6 * s**5) * WAY
            forth = 1.0 if t < MOVING + HOLDING else -1.0
            rate = forth * (30 * s**2 - 60 * s**3 + 30 * s**4) / MOVING * WAY
            arm.write(q[:5], q[5], rate[:5])
            clock.advance(CYCLE)
            arm.read()
            if stops := alarms(arm.health):
                return str(stops)
            now = true_angles()
            fastest, was = max(fastest, np.abs(now - was)[driven].max() / CYCLE), now
            worst = max(worst, np.abs((now - began) - (q - first))[driven].max())
        arm.close()
    except So101Error as error:
        return str(error)
    off = np.degrees(np.abs(was - began)[driven]).max()
    if off > 1.5:
        return f"{off:.1f} deg off"
    if math.degrees(worst) > 8.0:
        return f"{math.degrees(worst):.1f} deg off on the way"
    if math.degrees(fastest) > 90.0:
        return f"{math.degrees(fastest):.0f} deg/s"
    return ""


def truth(*changes, **arm):
    """What goes wrong when an arm is moved that the driver does not refuse, whatever is set."""
    judge = servo_setup.odd_settings

    def adapted(held, counts_down):
        return [odd for odd in judge(held, counts_down=counts_down) if odd.is_adapted]

    with mock.patch.object(servo_setup, "odd_settings", adapted):
        return trouble_with_moving(spoilt(*changes, **arm))
