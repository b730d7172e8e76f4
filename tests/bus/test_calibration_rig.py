"""A new arm is calibrated on a real port by a hand that nobody tells what to do."""

import math

import pytest
from harness.heard_port import HeardEmulator

from so101_motion.calib.procedure.session import Session
from so101_motion.calib.record import store
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import MotionError
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.drivers.emulator.emulator import EmulatorOptions, sweeping_script
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.servo_driver import ServoSettings

PATIENCE = 0.05
JOINTS = (*ARM_JOINTS, GRIPPER_JOINT)


@pytest.fixture(autouse=True)
def own_home(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))


@pytest.fixture
def bench(tmp_path):
    """A new arm on a port, a hand, and a rig that drives nothing of it yet."""
    weight = RobotModel.load().gravity_torque
    script, end = sweeping_script(weight, pose={"elbow_flex": -0.2, "gripper": 0.5})
    clock = ManualClock()
    emulator = HeardEmulator(
        EmulatorOptions(link=tmp_path / "port", calibrated=False, hand=script),
        now=clock.now,
        gravity=weight,
    )
    settings = ServoSettings(
        port=str(tmp_path / "port"), timeout=0.0, calibration_file=tmp_path / "arm.json"
    )
    rig = open_hardware(settings, clock=clock, reply_timeout=PATIENCE, open_port=emulator.opener())
    yield rig, emulator, clock, end
    rig.close()
    emulator.close()


def pass_time(bench, seconds):
    _, emulator, clock, _ = bench
    for _ in range(round(seconds / 0.1)):
        clock.advance(0.1)
        emulator.advance()


def test_a_new_arm_is_calibrated_without_any_input(bench, tmp_path):
    rig, emulator, clock, end = bench
    session = Session(tmp_path / "arm.json")
    loan = rig.lend_bus("calibration")
    session.start(loan)
    with pytest.raises(MotionError, match="calibration"):
        rig.lend_bus("motor setup")
    pass_time(bench, 1.8)
    session.set_homing()
    session.start_recording()
    pass_time(bench, end - clock.now() + 0.5)
    view = session.view
    assert all(joint.is_done for joint in view.joints.values()), view.joints
    assert view.samples >= 50 * view.recording_time
    session.stop_recording()
    stored = session.save()
    assert not session.is_active
    loan.give_back(hold=True)

    for joint in JOINTS:
        shaft = emulator.world.servo(joint).drive.shaft
        entry = stored.calibration[joint]
        found = (entry.range_min + entry.homing_offset, entry.range_max + entry.homing_offset)
        assert found == pytest.approx((shaft.lower, shaft.upper), abs=3.0), joint

    pass_time(bench, 0.5)
    state = rig.executor.state
    assert state.mode is Mode.HOLDING
    truth = emulator.world.q
    for i, joint in enumerate(ARM_JOINTS):
        assert math.degrees(state.q[i] - truth[i]) == pytest.approx(0.0, abs=0.5), joint
    assert store.read(tmp_path / "arm.json").calibration == rig.servos.calibration
