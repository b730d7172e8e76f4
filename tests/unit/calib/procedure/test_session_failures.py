"""How a calibration is refused, fails or ends early, and how it goes on."""

import json
import threading

import pytest
from harness.calibration_rig import LentArm, all_held, calibrate, recording

from so101_motion.calib.procedure import journal
from so101_motion.calib.procedure.eeprom import HeldCalibration
from so101_motion.calib.procedure.session import Session
from so101_motion.calib.procedure.steps import Command, State
from so101_motion.calib.record.record import JOINTS
from so101_motion.common.errors import (
    CalibrationError,
    ConfigError,
    MotionError,
    NoReply,
    PortUnavailable,
)
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.emulator import registers as emulated

# Refusals and failures


@pytest.mark.parametrize("command", ["set_homing", "start_recording", "stop_recording", "save"])
def test_a_command_in_the_wrong_state_changes_nothing(arm, file, command):
    session = Session(file)
    with pytest.raises(CalibrationError, match='not possible in the state "idle"'):
        getattr(session, command)()
    assert session.view.state is State.IDLE
    assert session.view.error is None


def test_joints_must_be_joints(file):
    with pytest.raises(ConfigError, match="elbow"):
        Session(file, ["elbow"])
    with pytest.raises(ConfigError, match="at least one"):
        Session(file, [])


def test_a_missing_servo_is_named_at_the_start_and_nothing_has_to_be_put_back(arm, file):
    arm.world.disconnect("wrist_roll")
    session = Session(file)
    with pytest.raises(NoReply, match="servo 5"):
        session.start(arm)
    assert session.view.state is State.ERROR
    assert session.view.commands == (Command.RESET, Command.START)
    assert not session.is_active
    assert session.reset().state is State.IDLE


def test_an_arm_that_is_not_held_still_while_homing_is_set_is_found_out(arm, file):
    session = Session(file)
    session.start(arm)
    before = all_held(arm)
    arm.between = lambda _: arm.put(elbow_flex=arm.drive("elbow_flex").shaft.output + 40)
    with pytest.raises(CalibrationError, match=r"elbow_flex: reads 23\d\d .* instead of 2047"):
        session.set_homing()
    arm.between = lambda _: None
    assert session.view.state is State.ERROR
    assert session.is_active
    session.reset()
    assert all_held(arm) == before


def test_travels_from_the_jaw_to_the_base_show_that_the_ids_run_the_other_way(file):
    arm = LentArm(ids={place: 7 - place for place in range(1, 7)}, calibrated=False)
    session = recording(file, arm)
    arm.sweep_all()
    with pytest.raises(CalibrationError, match="the ids run from the jaw to the base"):
        session.stop_recording()


def test_saving_can_be_tried_again_when_a_servo_was_silent(arm, file):
    session = recording(file, arm)
    arm.sweep_all()
    session.stop_recording()
    before = all_held(arm)
    arm.world.disconnect("wrist_flex")
    with pytest.raises(NoReply):
        session.save()
    assert session.view.state is State.COMPLETED
    assert not file.exists()
    arm.world.connect("wrist_flex")
    arm.clock.t += 2.0
    assert all_held(arm) == before  # it was found out before anything was written
    session.save()
    assert file.exists()


def test_saving_can_be_tried_again_when_a_cable_came_loose_meanwhile(arm, file):
    session = recording(file, arm)
    arm.sweep_all()
    session.stop_recording()
    first = arm.calls

    def slip(calls):  # everybody was there, and two servos have been written
        if calls == first + 4:
            arm.world.disconnect("elbow_flex")

    arm.between = slip
    with pytest.raises(NoReply, match="servo 3"):
        session.save()
    assert session.view.state is State.COMPLETED
    assert journal.read(file).is_decided
    arm.world.connect("elbow_flex")
    arm.clock.t += 2.0
    stored = session.save()
    assert {joint: arm.held(joint) for joint in JOINTS} == {
        joint: HeldCalibration.of(entry) for joint, entry in stored.calibration.items()
    }


def test_saving_can_be_tried_again_when_the_file_could_not_be_written(arm, tmp_path):
    folder = tmp_path / "calibrations"
    file = folder / "arm.json"
    session = recording(file, arm)
    arm.sweep_all()
    session.stop_recording()
    file.mkdir()
    with pytest.raises(CalibrationError):
        session.save()
    assert session.view.state is State.COMPLETED
    file.rmdir()
    session.save()
    assert set(json.loads(file.read_text())) == set(JOINTS)


def test_homing_is_refused_when_no_journal_can_be_written(arm, tmp_path):
    (tmp_path / "file").write_text("in the way")
    session = Session(tmp_path / "file" / "arm.json")
    session.start(arm)
    before = all_held(arm)
    with pytest.raises(CalibrationError, match="cannot be written"):
        session.set_homing()
    assert all_held(arm) == before


# Ending it early


@pytest.mark.parametrize("steps", [1, 2, 3, 4])
@pytest.mark.parametrize("command", ["abort", "reset"])
def test_aborting_puts_the_servos_back(arm, file, steps, command):
    calibrate(file, arm)
    before, said = all_held(arm), file.read_bytes()
    arm.put_deg(shoulder_pan=80, elbow_flex=-50, gripper=100)
    session = Session(file)
    session.start(arm)
    if steps > 1:
        session.set_homing()
    if steps > 2:
        session.start_recording()
        arm.sweep_all()
    if steps > 3:
        session.stop_recording()
    assert getattr(session, command)().state is State.IDLE
    assert all_held(arm) == before
    assert file.read_bytes() == said
    view = session.view
    assert view.joints["gripper"].range_max == before["gripper"].range_max
    assert view.joints["gripper"].recorded_max is None
    assert view.recording_time == 0.0
    assert not journal.path_for(file).exists()
    assert not session.is_active


def test_aborting_after_a_failed_save_puts_the_servos_back(arm, file):
    session = recording(file, arm)
    before = {joint: HeldCalibration(homing_offset=0) for joint in JOINTS}
    arm.sweep_all()
    session.stop_recording()
    file.mkdir()
    with pytest.raises(CalibrationError):
        session.save()
    assert all_held(arm) != before
    session.abort()
    assert all_held(arm) == before


def test_an_abort_that_fails_can_be_repeated(arm, file):
    session = recording(file, arm)
    arm.wire.unplugged = True
    with pytest.raises(PortUnavailable):
        session.abort()
    assert session.view.state is State.ERROR
    assert journal.path_for(file).exists()
    arm.wire.unplugged = False
    session.reset()
    assert all_held(arm) == {joint: HeldCalibration(homing_offset=0) for joint in JOINTS}


def test_starting_again_begins_from_what_was_there_at_first(arm, file):
    before = all_held(arm)
    session = recording(file, arm)
    arm.sweep_all()
    session.stop_recording()
    session.start(arm)
    assert all_held(arm) == before
    session.set_homing()
    session.abort()
    assert all_held(arm) == before


def test_closing_puts_the_servos_back(arm, file):
    session = recording(file, arm)
    session.close()
    session.close()
    assert all_held(arm) == {joint: HeldCalibration(homing_offset=0) for joint in JOINTS}
    assert not session.is_active


def test_the_next_start_rolls_back_what_closing_could_not(arm, file):
    session = recording(file, arm)
    arm.wire.unplugged = True
    session.close()
    assert not session.is_active
    arm.wire.unplugged = False
    view = Session(file).start(arm)
    assert view.note == (
        "A calibration was interrupted before it was saved; the servos' settings were restored."
    )
    assert all_held(arm) == {joint: HeldCalibration(homing_offset=0) for joint in JOINTS}


def test_a_loan_that_was_ended_by_force_can_be_followed_by_another(arm, file):
    session = recording(file, arm)
    other = LentArm(calibrated=False)

    def over(*_):
        raise MotionError("the servos are no longer in use for calibration")

    arm.watch, arm.between = over, over
    with pytest.raises(MotionError):
        session.abort()
    journal.recover(arm.bus, file)  # as the port's next user does
    assert session.start(other).state is State.STARTED
    session.abort()
    assert all_held(other) == {joint: HeldCalibration(homing_offset=0) for joint in JOINTS}


def test_offsets_of_newer_firmware_are_put_back_as_their_equals(arm, file):
    memory = arm.world.servo("elbow_flex").memory
    memory.keep(emulated.OFFSET, emulated.encode_offset(3000))
    arm.world.servo("elbow_flex").boot()
    read = arm.bus.read(3, reg.PRESENT_POSITION)
    session = recording(file, arm)
    session.abort()
    assert arm.held("elbow_flex").homing_offset == 3000 - 4096
    assert arm.bus.read(3, reg.PRESENT_POSITION) == read


# From other threads


def test_the_view_waits_for_nobody(arm, file):
    session = Session(file)
    inside, go_on = threading.Event(), threading.Event()
    call = arm.call

    def slow(job):
        inside.set()
        go_on.wait(60)
        return call(job)

    arm.call = slow
    thread = threading.Thread(target=session.start, args=(arm,))
    thread.start()
    assert inside.wait(60)
    assert session.view.state is State.IDLE  # the bus is busy, and still this answers
    go_on.set()
    thread.join(60)
    assert session.view.state is State.STARTED
