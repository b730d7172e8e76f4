"""What two identifications of one arm tell of its servos."""

from dataclasses import replace

import pytest

from so101_motion.calib.procedure.servo_fit import Load
from so101_motion.calib.record import servo_file
from so101_motion.calib.record.servo_file import ServoRecord
from so101_motion.common.geometry import SE3
from so101_motion.drivers.servo_types import ServoFigures
from so101_motion.planning.collision.scene import Attached, Box
from so101_motion.planning.goals import JointGoal
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.setup.checkup import Findings, check_up, is_healthy
from so101_motion.setup.identify import changes_since, count_with

MARCH = ServoRecord(
    at="2026-03-05T10:00:00+00:00",
    volts=12.0,
    servos={
        "elbow_flex": ServoFigures(torque=1.0, friction=1.0),
        "wrist_flex": ServoFigures(torque=1.1, friction=0.5),
    },
)


@pytest.fixture
def path(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return tmp_path / "arm.json"


def identified_again(path, **figures):
    """Save figures of March, then of June."""
    servo_file.save(path, MARCH)
    servos = {**MARCH.servos, **figures}
    servo_file.save(path, replace(MARCH, at="2026-06-01T10:00:00+00:00", servos=servos))


def test_a_joint_that_has_changed_since_the_last_time_is_named_with_how_much(path):
    elbow, wrist = ServoFigures(torque=0.7), ServoFigures(torque=1.1, friction=0.8)
    identified_again(path, elbow_flex=elbow, wrist_flex=wrist)
    assert changes_since(path) == (
        "elbow_flex has 30% less torque than on 2026-03-05",
        "wrist_flex has 60% more friction than on 2026-03-05",
    )


def test_changes_as_small_as_those_of_two_identifications_are_not_reported_nor_the_first(path):
    assert changes_since(path) == ()
    servo_file.save(path, MARCH)
    assert changes_since(path) == ()
    identified_again(path, elbow_flex=ServoFigures(torque=1.2, friction=0.8))
    assert changes_since(path) == ()


def test_figures_that_cannot_be_read_are_reported_instead(path):
    servo_file.servos_path(path).write_text('{"servos": 3}')
    (sentence,) = changes_since(path)
    assert 'holds no "servos"' in sentence


def test_a_changed_servo_is_a_warning_that_says_what_to_do():
    change = "wrist_flex has 60% more friction than on 2026-03-05"
    checks = check_up(Findings(servo_changes=(change,)))
    found = next(check for check in checks if check.sentence == change)
    assert found.verdict == "warn"
    assert "identify again" in found.fix
    assert is_healthy((found,)), "the arm can be moved all the same"


REACHING = JointGoal(q=[0.0, 1.2, -0.6, 0.3, 0.0])
HEAVY = Load(mass=0.3, com=(0.0, 0.0, -0.05), mass_deviation=0.004)


@pytest.fixture
def arm(clock):
    with open_simulated(clock=clock) as rig:
        yield rig.arm


def test_plans_count_with_a_load_that_was_weighed_if_it_is_surely_one(arm):
    count_with(arm, replace(HEAVY, mass=0.01))
    assert arm.request(REACHING).payload is None
    count_with(arm, HEAVY)
    assert arm.request(REACHING).payload.mass == pytest.approx(0.3)


def test_what_the_scene_says_of_the_hand_is_not_counted_twice(arm):
    held = Attached(
        name="cup", shape=Box(size=(0.05, 0.05, 0.05)), T_tool_object=SE3.identity(), mass=0.3
    )
    arm.scene = replace(arm.scene, attached=(held,))
    count_with(arm, HEAVY)
    assert arm.request(REACHING).payload is None
