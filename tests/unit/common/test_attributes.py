import math
import time

import pytest

from so101_motion.common.attributes import LoadConfig, suggest
from so101_motion.common.errors import ConfigError
from so101_motion.viam.component_config import HardwareArmConfig, SimulatedArmConfig


def hardware(attributes):
    return HardwareArmConfig.from_attributes({"port": "/dev/null", **attributes})


@pytest.mark.parametrize(
    ("key", "given", "name", "read"),
    [
        ("speed_degs_per_sec", 60.0, "speed", math.radians(60.0)),
        ("acceleration_degs_per_sec_per_sec", 200.0, "acceleration", math.radians(200.0)),
        ("motion", "mine", "motion", "mine"),
        ("simulate_time", False, "simulate_time", False),
        ("visualize_ee_frame", True, "visualize_ee_frame", True),
        ("use_urdf", True, "use_urdf", True),
        ("floor_z_mm", -10.0, "floor_z", -0.01),
        ("position_tolerance_mm", 2.0, "position_tolerance", 0.002),
        ("orientation_tolerance_deg", 30.0, "approach_tolerance", math.radians(30.0)),
        ("mesh_decimation_ratios", [0.9, 0.5], "unused", ("mesh_decimation_ratios",)),
    ],
)
def test_every_attribute_is_read_in_si(key, given, name, read):
    config = SimulatedArmConfig.from_attributes({key: given})
    assert getattr(config, name) == (pytest.approx(read) if isinstance(read, float) else read)


def test_nulls_empty_strings_and_zero_tolerances_count_as_not_given():
    given = {"motion": "", "speed_degs_per_sec": None}
    given |= {"position_tolerance_mm": 0.0, "orientation_tolerance_deg": 0.0}
    assert SimulatedArmConfig.from_attributes(given) == SimulatedArmConfig.from_attributes({})


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("max_speed_degs_per_sec", 0.0, "from 3 to 180 deg/s"),
        ("max_speed_degs_per_sec", -1.0, "from 3 to 180 deg/s"),
        ("max_speed_degs_per_sec", 181.0, "from 3 to 180 deg/s"),
        ("speed_degs_per_sec", math.nan, "finite"),
        ("speed_degs_per_sec", "fast", "a number"),
        ("speed_degs_per_sec", True, "a number"),
        ("acceleration_degs_per_sec_per_sec", 9.0, "from 10 to 500 deg/s^2"),
        ("motion", 3.0, "a string"),
        ("simulate_time", 1.0, "true or false"),
        ("simulate_time", "no", "true or false"),
        ("floor_z_mm", math.inf, "finite"),
        ("position_tolerance_mm", -1.0, "from 0 to 1000 mm"),
        ("orientation_tolerance_deg", 181.0, "from 0 to 180 deg"),
        ("mesh_decimation_ratios", 0.5, "a list"),
        ("payload_com_mm", [0.1] * 6, "at most 3"),
        ("payload_com_mm", [8.0, 0.0], "must be three numbers"),
        ("payload_kg", 150.0, "from 0 to 5 kg"),
        ("payload_kg", -0.1, "from 0 to 5 kg"),
        ("servo_voltage", 5.0, "must be 7.4 or 12"),
        ("speed_degs_per_sec", 10**400, "finite"),  # beyond all floats
        ("sped_degs_per_sec", 3.0, 'did you mean "speed_degs_per_sec"?'),
        ("sped_degs_per_sec", 3.0, "simulate_time"),
    ],
)
def test_a_value_that_cannot_be_used_is_named_with_what_is_allowed(key, value, says):
    with pytest.raises(ConfigError, match=f'^"{key}" = ') as caught:
        SimulatedArmConfig.from_attributes({key: value})

    assert says in str(caught.value)
    assert caught.value.key == key


@pytest.mark.parametrize(
    ("key", "entries"),
    [("mesh_decimation_ratios", [0.5, each]) for each in (math.nan, 1.1, -0.1, "half")]
    + [("payload_com_mm", [8.0, 5000.0, 0.0])],
)
def test_a_wrong_entry_of_a_list_is_named_by_its_index(key, entries):
    with pytest.raises(ConfigError, match=rf"{key}\[1\]"):
        SimulatedArmConfig.from_attributes({key: entries})


def test_a_suggestion_is_only_made_when_something_is_near_and_never_of_all_there_is():
    assert suggest("zzz", ("speed", "motion")) == "known: speed, motion"
    assert suggest("spede", ("speed", "motion")).startswith('did you mean "speed"?')
    hint = suggest("word 7", [f"word {i}" for i in range(100_000)])
    assert hint.endswith("and 99750 more")
    begin = time.thread_time()
    assert suggest("a" * 1_000_000, ("speed", "motion")) == "known: speed, motion"
    assert time.thread_time() - begin < 0.5


def test_what_the_arm_carries_is_read_in_kilograms_and_millimetres():
    config = SimulatedArmConfig.from_attributes(
        {"payload_kg": 0.15, "payload_com_mm": [8.0, 0.0, 98.0], "servo_voltage": 12}
    )
    assert config.load == LoadConfig(mass=0.15, com=(0.008, 0.0, 0.098), servo_voltage=12.0)
    assert SimulatedArmConfig.from_attributes({}).load == LoadConfig()


@pytest.mark.parametrize("read", [SimulatedArmConfig.from_attributes, hardware])
def test_the_arm_s_own_caps_are_never_above_what_no_request_exceeds(read):
    wanted = read({"max_speed_degs_per_sec": 20.0, "max_acceleration_degs_per_sec_per_sec": 60.0})
    assert wanted.speed == wanted.max_speed == pytest.approx(math.radians(20.0))
    assert wanted.acceleration == wanted.max_acceleration == pytest.approx(math.radians(60.0))
    with pytest.raises(ConfigError, match="above max_speed_degs_per_sec, 20"):
        read({"max_speed_degs_per_sec": 20.0, "speed_degs_per_sec": 21.0})
    assert read({}).max_speed == pytest.approx(math.pi)
