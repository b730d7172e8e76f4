import pytest

from so101_motion.alarms import alarms
from so101_motion.drivers.health import JointHealth


def joint(name="elbow_flex", **changes):
    figures = {
        "joint": name, "servo_id": 3, "t": 0.0, "is_silent": False, "volts": 12.0, "amps": 0.2,
        "temperature_c": 30, "load": 0.1, "faults": (), "latched": (), "answers": 9, "lost": 0,
        "corrupt": 0, "retries": 0,
    }  # fmt: skip
    return JointHealth(**{**figures, **changes})


def test_a_healthy_servo_alarms_nobody():
    assert alarms((joint(), joint("gripper", temperature_c=64, latched=("overload",)))) == {}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"temperature_c": 65}, "65 degC"),
        ({"faults": ("overheated",), "temperature_c": 40}, "40 degC"),
        ({"faults": ("overload",), "load": -0.8}, "80 % drive"),
        ({"faults": ("overcurrent",), "amps": 2.1}, "2.10 A"),
        ({"faults": ("voltage",), "volts": 5.1}, "5.1 V"),
        ({"volts": 5.0}, "only 5.0 V"),
        ({"faults": ("encoder",)}, "encoder"),
    ],
)
def test_trouble_is_named_by_joint_with_its_figure(changes, says):
    found = alarms((joint(**changes), joint("gripper")))

    assert set(found) == {"elbow_flex"}
    assert says in found["elbow_flex"]


def test_a_silent_servo_is_the_driver_s_to_report():
    assert alarms((joint(is_silent=True, temperature_c=80),)) == {}
