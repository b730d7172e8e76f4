"""The setup's own words for the states of motors."""

from so101_viewer.setup import cards

from so101_motion.calib.motors.setup_view import MotorCheck, MotorView, Verification
from so101_motion.calib.record.record import JOINTS

SUPPLY = "switch the power off now and use a supply of 12 V"
CABLE = "check the cable between servos 1 and 2; then verify again"


def chain(status: str, *, error: str, fix: str, sound: int = 0) -> Verification:
    """Six motors; those beyond the first ``sound`` have one trouble."""
    motors = {
        joint: MotorCheck(joint=joint, servo_id=i, status="ok")
        if i <= sound
        else MotorCheck(joint=joint, servo_id=i, status=status, error=f"servo {i} {error}", fix=fix)
        for i, joint in enumerate(JOINTS, start=1)
    }
    return Verification(motors=motors, unexpected_ids=(), notes=(), sentence="")


def test_one_trouble_of_many_motors_is_reported_once() -> None:
    hot = chain("wrong_voltage", error="gets 15.5 V", fix=SUPPLY)
    assert cards.troubles(hot) == [("servo 1 gets 15.5 V; the same with 2, 3, 4, 5, 6", SUPPLY)]
    cut = chain("not_responding", error="does not answer", fix=CABLE, sound=1)
    assert cards.troubles(cut) == [("servo 2 does not answer; the same with 3, 4, 5, 6", CABLE)]
    last = chain("not_responding", error="does not answer", fix=CABLE, sound=5)
    assert cards.troubles(last) == [("servo 6 does not answer", CABLE)]


def test_a_motor_that_is_waited_for_shows_the_id_it_gets_and_not_who_is_on_the_cable() -> None:
    other = MotorView(joint="wrist_roll", target_id=5, state="found", found_id=6, baud=1_000_000)
    waited = cards.motor(other, state="now", words="", fix="")
    assert "gets id 5" in waited
    assert "id 6" not in waited
    assert "id 6 → 5, 1 Mbaud" in cards.motor(other, state="found", words="", fix="")


def test_a_motor_that_was_skipped_is_not_said_to_get_its_id() -> None:
    view = MotorView(joint="wrist_roll", target_id=5)
    told = cards.motor_list([(view, "skipped")])
    assert "skipped" in told
    assert "gets id" not in told
