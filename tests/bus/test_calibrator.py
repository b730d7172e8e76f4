"""Calibrating on a port that goes away; holding an arm that has no component, letting it go."""

import numpy as np
import pytest
from harness.heard_port import HeardEmulator
from harness.held_calibration import put

from so101_motion.calib.record import store
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import CalibrationError
from so101_motion.common.modes import Mode
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.emulator import registers as emu
from so101_motion.drivers.emulator.emulator import EmulatorOptions
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.servo_driver import ServoSettings
from so101_motion.setup.calibrator import Calibrator

PATIENCE = 0.2


class Arm:
    """A new arm on a port, and a calibrator on it; nothing has weight."""

    def __init__(self, folder):
        self.clock = ManualClock()
        self.emulator = HeardEmulator(
            EmulatorOptions(link=folder / "port", calibrated=False), now=self.clock.now
        )
        settings = ServoSettings(
            port=str(folder / "port"), timeout=None, fallback_file=folder / "arm.json"
        )
        self.rig = open_hardware(
            settings, clock=self.clock, reply_timeout=PATIENCE, open_port=self.emulator.opener()
        )
        self.calibrator = Calibrator(self.rig)

    def close(self):
        self.calibrator.close()
        self.emulator.close()

    def pass_time(self, seconds):
        self.clock.advance(seconds)
        self.emulator.advance()

    def calibrate(self):
        put(self.emulator.world, 0.5)
        self.calibrator.start()
        self.calibrator.set_homing()
        self.calibrator.start_recording()
        for share in (0.5, 0.3, 0.1, 0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 0.8, 0.6, 0.5):
            put(self.emulator.world, share)
            self.pass_time(0.05)
        self.calibrator.stop_recording()
        self.calibrator.save()
        return self.calibrator.ended

    @property
    def held(self):
        rows = (emu.OFFSET, emu.MIN_POSITION, emu.MAX_POSITION)
        return [[servo.memory.raw(row) for row in rows] for servo in self.emulator.world.servos]

    @property
    def driven(self):
        return [servo.memory.raw(emu.TORQUE_ENABLE) == 1 for servo in self.emulator.world.servos]


@pytest.fixture
def arm(tmp_path):
    arm = Arm(tmp_path)
    yield arm
    arm.close()


def test_a_recording_outlives_the_usb_plug(arm):
    calibrator = arm.calibrator
    calibrator.start()
    calibrator.set_homing()
    calibrator.start_recording()
    for share in (0.5, 0.1):
        put(arm.emulator.world, share)
        arm.pass_time(0.05)
    arm.emulator.unplug()
    arm.clock.advance(1.5)
    assert "USB cable" in calibrator.view.error
    arm.emulator.plug()
    arm.clock.advance(1.0)
    assert calibrator.view.error is None
    for share in (0.0, 0.4, 0.8, 1.0):
        put(arm.emulator.world, share)
        arm.pass_time(0.05)
    calibrator.stop_recording()
    shaft = arm.emulator.world.servo("elbow_flex").drive.shaft
    elbow = calibrator.save().calibration["elbow_flex"]
    assert elbow.range_min + elbow.homing_offset == pytest.approx(shaft.lower, abs=1.0)


def test_a_calibrated_arm_knows_its_angles_and_has_nothing_to_go_back_to_at_first(arm, tmp_path):
    stored = arm.calibrate().stored
    for joint, entry in stored.calibration.items():
        shaft = arm.emulator.world.servo(joint).drive.shaft
        found = (entry.range_min + entry.homing_offset, entry.range_max + entry.homing_offset)
        assert found == pytest.approx((shaft.lower, shaft.upper), abs=3.0), joint
    assert store.read(tmp_path / "arm.json").calibration == arm.rig.servos.calibration
    arm.pass_time(0.1)
    off = np.degrees(arm.rig.arm.state.q - arm.emulator.world.q[:5])
    assert np.abs(off[:4]).max() < 0.5, "a roll is as it was held"
    with pytest.raises(CalibrationError, match="no earlier version"):
        arm.calibrator.restore()
    arm.pass_time(0.1)
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
    arm.emulator.world.disconnect("wrist_flex")
    ended = arm.calibrator.hold()
    assert arm.driven == [True, True, True, False, True, True]
    assert ended.holds
    assert "wrist_flex does not answer" in ended.trouble


def drive(arm):
    """Another program has left the torque of all servos on."""
    for servo in arm.emulator.world.servos:
        servo.memory.set(emu.TORQUE_ENABLE, 1)


def test_a_held_arm_is_let_go_of_and_can_be_held_again(arm):
    arm.calibrator.hold()
    arm.calibrator.let_go()
    assert not any(arm.driven)
    assert arm.rig.arm.state.mode is Mode.LIMP
    arm.pass_time(0.2)
    assert arm.calibrator.situation.holds is False
    assert arm.calibrator.hold().holds
    assert all(arm.driven)


def test_letting_go_ends_hand_guiding_and_so_does_holding(arm):
    arm.calibrate()
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
    arm.emulator.world.disconnect("wrist_flex")
    arm.calibrator.let_go()
    assert arm.driven == [False, False, False, True, False, False]  # nobody can reach that one
    arm.emulator.world.connect("wrist_flex")
    arm.calibrator.abort()
