import pytest

from so101_motion.drivers.feetech.health import JointHealth
from so101_motion.drivers.feetech.servo_judgement import alarms, judge, share_of_speed


def joint(name="elbow_flex", **changes):
    figures = {
        "joint": name, "servo_id": 3, "t": 0.0, "is_silent": False, "volts": 12.0, "amps": 0.2,
        "temperature_c": 30, "load": 0.1, "faults": (), "latched": (), "answers": 9, "lost": 0,
        "corrupt": 0, "retries": 0,
    }  # fmt: skip
    return JointHealth(**{**figures, **changes})


def test_a_healthy_servo_alarms_nobody_and_a_silent_one_is_the_driver_s_to_report():
    assert alarms((joint(is_silent=True, temperature_c=80),)) == {}
    assert alarms((joint(), joint("gripper", temperature_c=64, latched=("overload",)))) == {}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"temperature_c": 65}, "65 °C"),
        ({"faults": ("overheated",), "temperature_c": 40}, "40 °C"),
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


@pytest.mark.parametrize(
    ("celsius", "share"), [((), 1.0), ((30, 55), 1.0), ((30, 60), 0.625), ((65, 30), 0.25)]
)
def test_the_hottest_servo_says_how_fast_the_arm_may_be(celsius, share):
    assert share_of_speed([joint(temperature_c=each) for each in celsius]) == share


@pytest.mark.parametrize(
    ("volts", "highest", "level"),
    [
        (12.1, 14.0, None),
        (5.0, 8.0, "note"),  # many 7.4 V arms are fed with 5 V
        (4.4, 8.0, "stop"),
        (12.1, 8.0, "stop"),
        (7.4, 14.0, "warn"),
        (5.4, 14.0, "stop"),
        (5.4, None, "stop"),
    ],
)
def test_a_supply_is_judged_by_the_kind_of_servo_it_feeds(volts, highest, level):
    found = judge(volts=volts, highest_volts=highest, celsius=30, load=0.0, amps=0.0, faults=())

    assert [trouble.level for trouble in found] == ([] if level is None else [level])
    assert all(f"{volts:.1f} V" in trouble.sentence for trouble in found)
