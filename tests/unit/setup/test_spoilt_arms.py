"""Doctor over arms whose servos somebody has spoilt: what it says is what the arm then does.

Whether an arm moves well is not our opinion: the driver opens it, as the rig does, and leads it
along a short path against the emulated arm's true angles. Simulated time throughout.
"""

import math

import numpy as np
import pytest
from harness.lent_bus import LentBus

from so101_motion.calib.motors import chain_check
from so101_motion.calib.motors.arm_identification import ServoFacts
from so101_motion.calib.motors.servo_search import Tuner
from so101_motion.calib.record.record import JOINTS, SERVO_IDS
from so101_motion.common.errors import So101Error
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.ticks import JointMap, Ticks
from so101_motion.drivers.emulator import registers as emulated
from so101_motion.drivers.feetech import servo_setup
from so101_motion.drivers.feetech.feetech_arm import FeetechArm
from so101_motion.drivers.feetech.servo_judgement import alarms
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.joint_setup import find_joints
from so101_motion.rig.servo_finder import ACCELERATION_CAP, SPEED_CAP
from so101_motion.setup.checkup import check_up, is_healthy
from so101_motion.setup.findings import Findings

WEIGHT = RobotModel.load().gravity_torque
START = np.radians([0.0, 25.0, -25.0, 0.0, 0.0, 20.0])  # to be stretched out at the end
WAY = np.radians([20.0, 30.0, -30.0, 25.0, 25.0, 10.0])
MOVING, HOLDING = 1.5, 2.6  # [s]; a servo lets go of an overload after 2 s


def spoilt(*changes):
    """An arm of which some servos hold other values: (place, register, raw value)."""
    bus = LentBus(q_start=tuple(START))
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
            Bus(bus.wire, reply_timeout=0.0), SERVO_IDS, required=JOINTS[:5], timeout=0.0,
            file=None, may_file_be_missing=True, jaw_closed=-0.17, zero_offsets={},
        )  # fmt: skip
        arm = FeetechArm(
            lambda: bus.wire, clock, {joint: each.map for joint, each in found.setups.items()},
            gravity=WEIGHT, speed=SPEED_CAP, acceleration=ACCELERATION_CAP, reply_timeout=0.0,
        )  # fmt: skip
        reading = arm.read()
        first = np.array([*reading.q, reading.q_jaw])
        arm.write(reading.q, reading.q_jaw)
        arm.set_torque(True)
        was = began = true_angles()
        fastest, worst = 0.0, 0.0
        for step in range(round((MOVING + HOLDING) / 0.01)):
            s = min(step * 0.01 / MOVING, 1.0)
            q = first + (10 * s**3 - 15 * s**4 + 6 * s**5) * WAY
            rate = (30 * s**2 - 60 * s**3 + 30 * s**4) / MOVING * WAY
            arm.write(q[:5], q[5], rate[:5])
            clock.advance(0.01)
            arm.read()
            if stops := alarms(arm.health):
                return str(stops)
            now = true_angles()
            fastest, was = max(fastest, np.abs(now - was).max() / 0.01), now
            worst = max(worst, np.abs((now - began) - (q - first)).max())
        arm.close()
    except So101Error as error:
        return str(error)
    off = np.degrees(np.abs(was - began - WAY)).max()
    if off > 1.5:
        return f"{off:.1f} deg off"
    if math.degrees(worst) > 8.0:
        return f"{math.degrees(worst):.1f} deg off on the way"
    if math.degrees(fastest) > 90.0:
        return f"{math.degrees(fastest):.0f} deg/s"
    return ""


SINGLE = [
    (), ("LED_ALARM", 0), ("RETURN_DELAY", 254),
    ("PHASE", 0), ("PHASE", 4), ("PHASE", 8), ("PHASE", 28), ("PHASE", 13), ("PHASE", 140),
    ("PHASE", 141), ("PHASE", 157),
    ("P_GAIN", 0), ("P_GAIN", 4), ("P_GAIN", 16), ("P_GAIN", 64), ("D_GAIN", 0), ("D_GAIN", 100),
    ("I_GAIN", 10), ("I_GAIN", 254), ("STARTUP_FORCE", 0), ("STARTUP_FORCE", 254),
    ("CW_DEAD_ZONE", 0), ("CW_DEAD_ZONE", 32), ("CCW_DEAD_ZONE", 32), ("RESOLUTION", 3),
    ("MODE", 1), ("MODE", 2), ("MODE", 3), ("STATUS_LEVEL", 0), ("MIN_POSITION", 4000),
    ("MAX_TEMPERATURE", 20), ("MAX_TEMPERATURE", 45), ("MAX_VOLTAGE", 80), ("MIN_VOLTAGE", 130),
    ("MAX_TORQUE", 0), ("MAX_TORQUE", 20), ("MAX_TORQUE", 300), ("UNLOADING", 0), ("UNLOADING", 63),
    ("PROTECTION_CURRENT", 0), ("PROTECTION_CURRENT", 2),
    ("PROTECTION_CURRENT", 250), ("OVERLOAD_TORQUE", 0),
    ("OVERLOAD_TORQUE", 25), ("PROTECTION_TIME", 0), ("OVERCURRENT_TIME", 0),
    ("PROTECTIVE_TORQUE", 0), ("MOVING_THRESHOLD", 254), ("D_WINDOW", 254), ("SPEED_UNIT", 1),
    ("MIN_SPEED", 254), ("MAX_SPEED", 0), ("MAX_SPEED", 20), ("MAX_ACCELERATION", 1),
    ("MAX_ACCELERATION", 254), ("BAUD", 1), ("ID", 9),
]  # fmt: skip

PAIRS = [
    (("PHASE", 0), ("MIN_SPEED", 254)), (("PHASE", 0), ("MODE", 1)), (("PHASE", 141), ("MODE", 3)),
    (("P_GAIN", 4), ("D_GAIN", 0)), (("P_GAIN", 4), ("STATUS_LEVEL", 0)),
    (("STATUS_LEVEL", 0), ("PHASE", 0)), (("RESOLUTION", 3), ("PHASE", 28)),
    (("CW_DEAD_ZONE", 16), ("CCW_DEAD_ZONE", 16)),
    (("OVERLOAD_TORQUE", 0), ("PROTECTIVE_TORQUE", 0)),
    (("MIN_POSITION", 3000), ("MAX_POSITION", 1000)), (("MIN_POSITION", 0), ("MAX_POSITION", 0)),
    (("MAX_TORQUE", 20), ("UNLOADING", 0)), (("MAX_SPEED", 5), ("MAX_ACCELERATION", 5)),
    (("MAX_TEMPERATURE", 20), ("UNLOADING", 0)), (("MODE", 2), ("BAUD", 3)),
]  # fmt: skip


@pytest.fixture
def unrefused(monkeypatch):
    """The driver refuses no setting, so what happens is not its opinion."""
    judge = servo_setup.odd_settings
    monkeypatch.setattr(
        servo_setup,
        "odd_settings",
        lambda held, counts_down: [o for o in judge(held, counts_down=counts_down) if o.is_adapted],
    )


@pytest.mark.parametrize("changes", [*[(one,) for one in SINGLE], *PAIRS], ids=str)
def test_what_doctor_says_of_a_spoilt_arm_is_what_it_does(unrefused, changes):
    changes = [(3, *one) for one in changes if one]
    healthy = doctor_lets_it_move(spoilt(*changes))
    trouble = trouble_with_moving(spoilt(*changes))
    assert healthy == (not trouble), trouble


@pytest.mark.parametrize("one", [("PHASE", 141), ("PHASE", 13), ("MAX_TORQUE", 0)], ids=str)
def test_a_servo_that_must_not_be_moved_is_refused_before_torque(one):
    bus = spoilt((3, *one))
    assert "so101 setup --repair" in trouble_with_moving(bus)
    assert not any(servo.drive.torque for servo in bus.world.servos)
    assert bus.holds(3, reg.PHASE, after_power_off=True) == dict([one]).get("PHASE", 12)


def test_a_servo_that_is_reversed_as_its_calibration_says_is_no_trouble():
    facts = ServoFacts(servo_id=3, held={"phase": 141}, counts_down=True)
    assert facts.odd_settings == ()


@pytest.mark.parametrize(("name", "value"), [("PHASE", 0), ("PHASE", 4), ("MIN_SPEED", 254)])
def test_a_joint_outside_its_limits_comes_in_at_a_crawl_whatever_the_unit_of_speeds(name, value):
    bus = spoilt((5, name, value))
    narrow = JointMap(servo_id=5, lower_ticks=Ticks(2600), upper_ticks=Ticks(3400))
    maps = {joint: JointMap(servo_id=i) for joint, i in SERVO_IDS.items()} | {"wrist_roll": narrow}
    arm = FeetechArm(
        lambda: bus.wire, bus.clock, maps,
        gravity=WEIGHT, speed=SPEED_CAP, acceleration=ACCELERATION_CAP, reply_timeout=0.0,
    )  # fmt: skip
    reading = arm.read()
    inside = np.array([*reading.q[:4], narrow.lower + 0.3])
    arm.write(reading.q, reading.q_jaw)
    arm.set_torque(True)
    fastest, was, first = 0.0, bus.world.q[4], bus.world.q[4]
    for _ in range(200):
        arm.write(inside, reading.q_jaw)
        arm.read()
        bus.clock.advance(0.01)
        bus.world.advance(bus.clock.now())
        fastest, was = max(fastest, abs(bus.world.q[4] - was) / 0.01), bus.world.q[4]
    assert abs(was - first) > math.radians(5.0)
    assert math.degrees(fastest) < 20.0  # a tick in 10 ms is 9
