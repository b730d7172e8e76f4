"""Calibrating on a port that goes away; holding an arm that has no component, letting it go."""

import numpy as np
import pytest
from harness.held_calibration import put

from so101_motion.calib.record import store
from so101_motion.common.errors import CalibrationError
from so101_motion.common.modes import Mode
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.emulator import registers as emu
from so101_motion.drivers.emulator.world import no_gravity
from so101_motion.setup.calibrator import Calibrator

pytestmark = pytest.mark.emulated(calibrated=False, reply_timeout=0.2)


@pytest.fixture
def arm(bench, tmp_path):
    """A new arm on a port, and a calibrator on it; nothing has weight."""
    bench.world.gravity = no_gravity
    bench.rig = bench.open(
        servo_ids=None, gripper_id=None, timeout=None, fallback_file=tmp_path / "arm.json"
    )
    bench.calibrator = Calibrator(bench.rig)
    yield bench
    bench.calibrator.close()


def lead(arm, *shares):
    """A hand puts all joints at these shares of their travels."""
    for share in shares:
        put(arm.world, share)
        arm.advance(0.05)
        arm.emulator.advance()


def calibrate(arm):
    put(arm.world, 0.5)
    arm.calibrator.start()
    arm.calibrator.set_homing()
    arm.calibrator.start_recording()
    lead(arm, 0.5, 0.3, 0.1, 0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 0.8, 0.6, 0.5)
    arm.calibrator.stop_recording()
    arm.calibrator.save()
    return arm.calibrator.ended


def test_a_recording_outlives_the_usb_plug(arm):
    calibrator = arm.calibrator
    calibrator.start()
    calibrator.set_homing()
    calibrator.start_recording()
    lead(arm, 0.5, 0.1)
    arm.emulator.unplug()
    arm.advance(1.5)
    assert "USB cable" in calibrator.view.error
    arm.emulator.plug()
    arm.advance(1.0)
    assert calibrator.view.error is None
    lead(arm, 0.0, 0.4, 0.8, 1.0)
    calibrator.stop_recording()
    shaft = arm.world.servo("elbow_flex").drive.shaft
    elbow = calibrator.save().calibration["elbow_flex"]
    assert elbow.range_min + elbow.homing_offset == pytest.approx(shaft.lower, abs=1.0)


def test_a_calibrated_arm_knows_its_angles_and_has_nothing_to_go_back_to_at_first(arm, tmp_path):
    stored = calibrate(arm).stored
    for joint, entry in stored.calibration.items():
        shaft = arm.world.servo(joint).drive.shaft
        found = (entry.range_min + entry.homing_offset, entry.range_max + entry.homing_offset)
        assert found == pytest.approx((shaft.lower, shaft.upper), abs=3.0), joint
    assert store.read(tmp_path / "arm.json").calibration == arm.rig.servos.calibration
    arm.advance(0.1)
    off = np.degrees(arm.rig.arm.state.q - arm.world.q[:5])
    assert np.abs(off[:4]).max() < 0.5, "a roll is as it was held"
    with pytest.raises(CalibrationError, match="no earlier version"):
        arm.calibrator.restore()
    arm.advance(0.1)
    assert all(arm.driven)
    assert arm.rig.arm.state.mode is Mode.HOLDING


def test_a_calibration_under_way_is_ended_first(arm):
    arm.calibrator.start()
    for call in (arm.calibrator.restore, arm.calibrator.hold):
        with pytest.raises(CalibrationError, match="under way"):
            call()
    assert not any(arm.driven)


def test_servos_that_miss_the_first_look_are_held_as_well(arm, monkeypatch):
    really_answering, looks = Bus.answering, []

    def answering(bus, servo_ids, **tries):
        looks.append(really_answering(bus, servo_ids, **tries))
        return [3] if len(looks) == 1 else looks[-1]

    monkeypatch.setattr(Bus, "answering", answering)
    ended = arm.calibrator.hold()
    assert all(arm.driven)
    assert ended.holds
    assert ended.trouble is None


def test_servos_that_have_fallen_silent_are_named_when_the_others_are_held(arm):
    arm.world.disconnect("wrist_flex")
    ended = arm.calibrator.hold()
    assert arm.driven == [True, True, True, False, True, True]
    assert ended.holds
    assert "wrist_flex does not answer" in ended.trouble


def drive(arm):
    """Another program has left the torque of all servos on."""
    for servo in arm.world.servos:
        servo.memory.set(emu.TORQUE_ENABLE, 1)


def test_a_held_arm_is_let_go_of_and_can_be_held_again(arm):
    arm.calibrator.hold()
    arm.calibrator.let_go()
    assert not any(arm.driven)
    assert arm.rig.arm.state.mode is Mode.LIMP
    arm.advance(0.2)
    assert arm.calibrator.situation.holds is False
    assert arm.calibrator.hold().holds
    assert all(arm.driven)


def test_letting_go_ends_hand_guiding_and_so_does_holding(arm):
    calibrate(arm)
    arm.rig.arm.set_manual(True)
    assert arm.calibrator.hold().holds
    assert arm.rig.arm.state.mode is Mode.HOLDING
    arm.rig.arm.set_manual(True)
    arm.calibrator.let_go()
    assert arm.rig.arm.state.mode is Mode.LIMP
    assert not any(arm.driven)


def test_joints_that_another_program_drives_are_let_go_of_also_in_a_calibration(arm):
    drive(arm)
    arm.calibrator.let_go()
    assert not any(arm.driven)
    arm.calibrator.start()
    drive(arm)
    arm.world.disconnect("wrist_flex")
    arm.calibrator.let_go()
    assert arm.driven == [False, False, False, True, False, False]  # nobody can reach that one
    arm.world.connect("wrist_flex")
    arm.calibrator.abort()
