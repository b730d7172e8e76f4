"""The list of setup steps that the command line and the page share, and each step's text."""

from dataclasses import replace
from pathlib import Path

import pytest

from so101_motion.calib.motors.setup_view import MotorCheck, SetupView, Verification
from so101_motion.calib.procedure import view as calibration_view
from so101_motion.calib.procedure.steps import State
from so101_motion.calib.record.record import JOINTS
from so101_motion.calib.record.store import Stored
from so101_motion.common.operation import Picture
from so101_motion.setup import setup_steps
from so101_motion.setup.assembly import AssemblyOperation
from so101_motion.setup.checkup import Check, Findings, check_up
from so101_motion.setup.setup_steps import CHAIN, CONNECT, FULL, MOTORS, MOTORS_ONLY, SetupState

PORT = Findings(port="/dev/ttyACM0", adapter="CH343")


def motors(**states):
    """A setup in which the motors of these joints are so far; the others are untouched."""
    view = SetupView()
    found = {
        joint: replace(
            motor, state=states.get(joint, "todo"), sentence=f"about {joint}", fix="mend"
        )
        for joint, motor in view.motors.items()
    }
    return replace(view, motors=found)


def chain(**wrong):
    checks = {
        joint: MotorCheck(
            joint=joint,
            servo_id=place,
            status="not_responding" if joint in wrong else "ok",
            error=wrong.get(joint, ""),
            fix="look at its cable" if joint in wrong else "",
        )
        for place, joint in enumerate(JOINTS, start=1)
    }
    return Verification(motors=checks, unexpected_ids=(), notes=(), sentence="")


def calibration(state, **changes):
    progress = calibration_view.CalibrationProgress(state=state, **changes)
    return calibration_view.show(progress, None, 0.0)


@pytest.mark.parametrize("step", FULL.steps, ids=lambda step: step.name)
def test_a_step_that_is_not_done_says_what_to_do(step):
    check = step.check(SetupState())
    assert check.verdict in ("fail", "warn")
    assert check.sentence
    assert check.fix


def test_the_first_step_that_is_not_done_comes_next():
    known = SetupState()
    assert FULL.next_open(known) is CONNECT
    known = replace(known, seen=PORT)
    assert FULL.next_open(known) is MOTORS
    known = replace(known, setup=motors(**dict.fromkeys(JOINTS, "configured")))
    assert FULL.next_open(known) is CHAIN
    wheels = replace(chain(), unexpected_ids=(7, 8, 9))
    assert FULL.next_open(SetupState(seen=replace(PORT, servos=wheels))) is setup_steps.POSE
    known = replace(known, seen=replace(PORT, servos=chain()))
    assert FULL.next_open(known) is setup_steps.POSE
    assert MOTORS_ONLY.next_open(known) is None
    known = replace(known, saved=Path("/data/arm.json"))
    assert FULL.next_open(known) is None


def test_the_connection_is_judged_as_the_doctor_does():
    for seen in (
        replace(PORT, port_trouble="in use by python3 (process 17); end that program first"),
        replace(PORT, interfering_programs={"ModemManager": "it talks to every new port"}),
        Findings(port_trouble="no adapter is plugged in"),
        Findings(lost_adapters=("a CH340 adapter is plugged in, but has no port: brltty",)),
        replace(PORT, supply_trouble=("it gets only 4.1 V", "switch the supply on")),
    ):
        check = CONNECT.check(SetupState(seen=seen))
        doctor = [c for c in check_up(seen) if c.verdict == check.verdict]
        assert (check.sentence, check.fix) == (doctor[0].sentence, doctor[0].fix)
        assert check.verdict != "ok"
    another = replace(PORT, lost_adapters=("a CH340 adapter is plugged in, but has no port",))
    for seen in (PORT, another):
        assert CONNECT.check(SetupState(seen=seen)).verdict == "ok"


def test_motors_that_are_left_are_counted_and_a_finished_arm_needs_no_setup():
    check = MOTORS.check(SetupState(setup=motors(gripper="configured", wrist_roll="verified")))
    assert check.verdict == "fail"
    assert check.sentence == "4 of 6 motors have not got their ids yet; next is wrist_flex"
    failed = MOTORS.check(SetupState(setup=motors(gripper="failed")))
    assert failed.sentence == "gripper: about gripper"
    assert failed.fix == "mend"
    setup = motors(**{**dict.fromkeys(JOINTS, "configured"), "elbow_flex": "skipped"})
    check = MOTORS.check(SetupState(setup=setup))
    assert check.verdict == "warn"
    assert "elbow_flex" in check.sentence
    known = SetupState(seen=replace(PORT, servos=chain()))
    assert MOTORS.check(known).verdict == "ok"
    assert MOTORS.check(replace(known, setup=motors(gripper="configured"))).verdict == "fail"


def test_the_chain_is_judged_as_the_doctor_does():
    servos = chain(elbow_flex="servo 3 (elbow_flex) does not answer")
    check = CHAIN.check(SetupState(seen=replace(PORT, servos=servos)))
    assert check.verdict == "fail"
    doctor = next(c for c in check_up(Findings(servos=servos)) if c.verdict == "fail")
    assert (check.sentence, check.fix) == (doctor.sentence, doctor.fix)
    assert CHAIN.check(SetupState(seen=replace(PORT, servos=chain()))).verdict == "ok"


def test_the_steps_of_a_calibration_follow_its_states_and_errors():
    pose, record, save = setup_steps.POSE, setup_steps.RECORD, setup_steps.SAVE
    done = {State.HOMED: [pose], State.RECORDING: [pose], State.COMPLETED: [pose, record]}
    for state in State:
        known = SetupState(view=calibration(state))
        found = [step for step in (pose, record, save) if step.check(known).verdict == "ok"]
        assert found == done.get(state, []), state
    known = SetupState(view=calibration(State.HOMED, error="servo 3 does not answer"))
    check = setup_steps.POSE.check(known)
    assert (check.verdict, check.sentence) == ("fail", "servo 3 does not answer")


def test_the_final_test_may_be_left_out_and_tells_what_it_found():
    assert setup_steps.TEST.check(SetupState()).verdict == "warn"
    found = Check(name="test", verdict="fail", sentence="elbow_flex is 4 deg off", fix="calibrate")
    assert setup_steps.TEST.check(SetupState(tested=found)) == found


def test_the_doctor_names_the_step_where_a_setup_has_to_go_on():
    def next_of(**seen):
        step = FULL.next_open(SetupState.found(replace(PORT, **seen)))
        return None if step is None else step.name

    assert FULL.next_open(SetupState.found(Findings(port_trouble="no port"))) is CONNECT
    assert next_of(servos=chain(elbow_flex="servo 3 does not answer")) == "chain"
    twins = chain()
    first = replace(twins.motors["shoulder_pan"], status="duplicate", error="two as 1", fix="part")
    twins = replace(twins, motors={**twins.motors, "shoulder_pan": first})
    assert next_of(servos=twins) == "motors"
    assert next_of(servos=chain()) == "pose"
    stored = Stored(path=Path("/data/arm.json"), calibration={}, zeros={}, notes=())
    assert next_of(servos=chain(), file=stored.path, stored=stored) is None
    assert next_of(servos=chain(), file=stored.path, stored=stored, is_unfinished=True) == "pose"


def test_each_joint_is_shown_swinging_until_all_are_right():
    now = [0.0]
    check = AssemblyOperation(lambda: now[0])
    assert check.view.rows[0].text.startswith("Motor 1 turns the arm on its base. Turn it by hand")
    for k, joint in enumerate(JOINTS):
        now[0] += 0.75
        picture: Picture = check.view.picture
        assert picture.lit == (joint,)
        assert [i for i in range(5) if picture.q[i]] == ([k] if k < 5 else [])
        assert (picture.q[5] > 0.6) is (joint == "gripper")
        assert not check.view.is_over
        check.ask("accept", **check.view.offers[0].arguments)
    assert check.view.is_over
    check.ask("look_at", joint="elbow_flex")
    assert check.view.rows[2].mark == "●"
    now[0] += 60.0
    assert not any(check.view.picture.q[:5]), "it swings for a while only"
