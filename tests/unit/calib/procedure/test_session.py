"""A calibration from start to end: states, seams and what is recorded."""

import json
import math
import threading

import pytest
from harness.calibration_rig import UPRIGHT_DEG, LentArm, all_held, calibrate, recording

from so101_motion.calib.procedure import journal
from so101_motion.calib.procedure.session import Session
from so101_motion.calib.procedure.steps import State
from so101_motion.calib.procedure.travel import Verdict
from so101_motion.calib.record.record import JOINTS, HeldCalibration
from so101_motion.common.errors import (
    CalibrationError,
    ConfigError,
    MotionError,
    NoReply,
    PortUnavailable,
)
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.emulator import registers as emulated

AS_NEW = dict.fromkeys(JOINTS, HeldCalibration(homing_offset=0))

# From start to end


@pytest.mark.parametrize(("joints", "torque"), [(JOINTS, [0] * 6), (["gripper"], [1] * 5 + [0])])
def test_starting_lets_go_of_its_joints_and_writes_nothing_for_good(arm, file, joints, torque):
    for servo_id in range(1, 7):
        arm.bus.write(servo_id, reg.TORQUE_ENABLE, 1)
    before = all_held(arm)
    session = Session(file, joints)
    assert not session.held_before
    session.start(arm)
    assert session.held_before
    assert [arm.world.servo(joint).drive.torque for joint in JOINTS] == torque
    assert all_held(arm) == before
    assert not journal.path_for(file).exists()


# Seams


def test_a_travel_across_the_seam_is_shown_going_on(file):
    arm = LentArm(calibrated=False)
    arm.put(elbow_flex=arm.stops("elbow_flex")[0])
    session = Session(file, ["elbow_flex"])
    session.start(arm)
    session.set_homing()
    session.start_recording()
    arm.sweep_all(["elbow_flex"])
    shown = session.view.joints["elbow_flex"]
    assert shown.ticks == shown.recorded_max > 4095
    assert shown.recorded_max - shown.recorded_min == 2198
    session.stop_recording()
    shown = session.view.joints["elbow_flex"]
    assert shown.ticks == shown.recorded_max == shown.range_max < 4096


def test_a_roll_that_is_not_swept_becomes_a_full_turn_about_its_zero(arm, file):
    arm.put_deg(wrist_roll=40)
    stored = calibrate(file, arm, led=JOINTS[:4] + JOINTS[5:])
    roll = stored.calibration["wrist_roll"]
    assert (roll.range_min, roll.range_max) == (0, 4095)
    zero_at = roll.homing_offset + 2047.5 - stored.zeros["wrist_roll"].angle * 4096 / math.tau
    assert zero_at == pytest.approx(2048 + (40 - UPRIGHT_DEG) * 4096 / 360, abs=1)


# While it records


def test_a_travel_that_is_meant_can_be_accepted(arm, file):
    session = recording(file, arm)
    arm.sweep_all([joint for joint in JOINTS if joint != "shoulder_pan"])
    arm.sweep("shoulder_pan", 1500, 2600)  # between two walls
    with pytest.raises(CalibrationError, match="shoulder_pan") as caught:
        session.stop_recording()
    assert caught.value.joint == "shoulder_pan"
    view = session.stop_recording(accept=["shoulder_pan"])
    assert (view.joints["shoulder_pan"].range_max - view.joints["shoulder_pan"].range_min) == 1100
    assert "shoulder_pan" not in session.save().zeros  # nobody knows where its stops are


def test_joints_that_were_not_moved_are_all_named_and_cannot_be_accepted(arm, file):
    session = recording(file, arm)
    with pytest.raises(CalibrationError, match=r"shoulder_pan: .*elbow_flex: .*gripper: "):
        session.stop_recording(accept=JOINTS)
    assert "gripper: not moved yet" in session.view.error
    with pytest.raises(ConfigError, match="accept"):
        session.stop_recording(accept=["elbow"])


def test_a_servo_that_counts_down_is_named_and_refused(arm, file):
    memory = arm.world.servo("elbow_flex").memory
    memory.keep(emulated.PHASE, memory.raw(emulated.PHASE) | emulated.PHASE_ENCODER_REVERSED)
    session = recording(file, arm)
    arm.tick(3)
    assert session.view.joints["elbow_flex"].verdict is Verdict.WRONG_DIRECTION
    with pytest.raises(CalibrationError, match="counts the wrong way round"):
        session.stop_recording(accept=JOINTS)


def test_a_servo_that_falls_silent_costs_the_others_nothing(arm, file):
    session = recording(file, arm)
    arm.sweep_all(JOINTS[:3])
    arm.world.disconnect("wrist_flex")
    arm.tick(30)
    view = session.view
    assert view.joints["wrist_flex"].sentence == "its servo does not answer"
    assert "no reply from wrist_flex" in view.error
    arm.sweep_all(["wrist_roll", "gripper"])
    arm.world.connect("wrist_flex")
    arm.clock.advance(2.0)
    arm.sweep_all(["wrist_flex"])
    assert session.view.error is None
    session.stop_recording()
    stored = session.save()
    assert (session.view.state, session.is_active, arm.watcher) == (State.IDLE, False, None)
    flex = stored.calibration["wrist_flex"]
    assert flex.range_min + flex.homing_offset == arm.stops("wrist_flex")[0]


# Refusals and failures


@pytest.mark.parametrize("command", ["set_homing", "start_recording", "stop_recording", "save"])
def test_a_command_in_the_wrong_state_changes_nothing(arm, file, command):
    session = Session(file)
    with pytest.raises(CalibrationError, match=r'the state "idle".*; now possible: "start"$'):
        getattr(session, command)()
    assert session.view.state is State.IDLE
    assert session.view.error is None
    for joints, says in ((["elbow"], "elbow"), ([], "at least one")):
        with pytest.raises(ConfigError, match=says):
            Session(file, joints)


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


@pytest.mark.parametrize("after", [1, 4])  # at once, or when two servos have been written
def test_saving_can_be_tried_again_when_a_cable_came_loose(arm, file, after):
    session = recording(file, arm)
    arm.sweep_all()
    session.stop_recording()
    before, first = all_held(arm), arm.calls

    def slip(calls):
        if calls == first + after:
            arm.world.disconnect("elbow_flex")

    arm.between = slip
    with pytest.raises(NoReply, match="servo 3"):
        session.save()
    assert session.view.state is State.COMPLETED
    assert not file.exists()
    arm.world.connect("elbow_flex")
    arm.clock.advance(2.0)
    assert (all_held(arm) == before) is (after == 1)  # found out before anything was written
    assert (after == 1) is not journal.read(file).is_decided
    stored = session.save()
    assert all_held(arm) == {joint: entry.held for joint, entry in stored.calibration.items()}


@pytest.mark.parametrize("then", ["save", "abort"])
def test_a_save_whose_file_could_not_be_written_is_tried_again_or_taken_back(arm, tmp_path, then):
    file = tmp_path / "calibrations" / "arm.json"
    session = recording(file, arm)
    arm.sweep_all()
    session.stop_recording()
    file.mkdir()
    with pytest.raises(CalibrationError):
        session.save()
    assert session.view.state is State.COMPLETED
    assert all_held(arm) != AS_NEW
    if then == "save":
        file.rmdir()
    getattr(session, then)()
    assert file.is_file() is (then == "save")
    assert (all_held(arm) == AS_NEW) is (then == "abort")
    assert then == "abort" or set(json.loads(file.read_text())) == set(JOINTS)


def test_homing_is_refused_when_no_journal_can_be_written(arm, tmp_path):
    (tmp_path / "file").write_text("in the way")
    session = Session(tmp_path / "file" / "arm.json")
    session.start(arm)
    before = all_held(arm)
    with pytest.raises(CalibrationError, match="cannot be written"):
        session.set_homing()
    assert all_held(arm) == before


# Ending it early


@pytest.mark.parametrize(
    ("steps", "command"), [(1, "abort"), (2, "reset"), (3, "abort"), (4, "reset")]
)
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


def test_an_abort_that_fails_can_be_repeated_and_the_next_start_does_what_closing_could_not(
    arm, file
):
    session = recording(file, arm)
    arm.wire.unplugged = True
    with pytest.raises(PortUnavailable):
        session.abort()
    assert session.view.state is State.ERROR
    assert journal.path_for(file).exists()
    arm.wire.unplugged = False
    session.reset()
    assert all_held(arm) == AS_NEW
    session = recording(file, arm)
    arm.wire.unplugged = True
    session.close()
    assert not session.is_active
    arm.wire.unplugged = False
    view = Session(file).start(arm)
    assert view.note == (
        "A calibration was interrupted before it was saved; the servos' settings were restored."
    )
    assert all_held(arm) == AS_NEW


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
    assert all_held(other) == AS_NEW


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
