"""Components leave a port and join it again, as viam-server reconfigures them; others stay."""

import logging

import numpy as np
import pytest
from grpclib import GRPCError, Status
from harness.emulated_rig import ModelBench
from harness.held_calibration import hold_calibration
from harness.in_process_module import refused
from viam.components.arm import JointPositions

from so101_motion.calib.record import record, store
from so101_motion.common.modes import Mode
from so101_motion.drivers.emulator import registers as emu
from so101_motion.viam.models.hardware_arm import HardwareArm
from so101_motion.viam.models.hardware_gripper import HardwareGripper

HOME = (0.0, -0.8, 0.8, 1.0, 0.0, 0.3)
A = {"shoulder_pan": (950, 3000), "gripper": (1950, 3300)}
B = {"shoulder_pan": (900, 3000), "gripper": (1900, 3300)}


@pytest.fixture
def data(data):
    """The module's data directory, with two calibrations."""
    for name, ranges in (("a.json", A), ("b.json", B)):
        made = {
            joint: record.JointCalibration(
                id=record.SERVO_IDS[joint],
                range_min=low,
                range_max=high,
                norm_mode=1 if joint == "gripper" else 3,
            )
            for joint, (low, high) in ranges.items()
        }
        store.save(data / name, made)
    return data


@pytest.fixture
async def bench(data, planning_process):
    bench = ModelBench(data, q_start=HOME)
    hold_calibration(bench.world, store.load(data / "a.json").calibration)
    yield bench
    await bench.end()


def new_gripper(bench, form):
    if form == "arm":
        return bench.new(HardwareGripper, "gripper", arm="arm")
    return bench.new_gripper()


async def replaced(bench, component, build):
    """What ``build`` makes in the component's place, where nothing may move meanwhile."""
    await bench.pass_time(1.0)
    before = bench.q_deg
    await bench.in_time(component.close())
    new = build()
    for _ in range(10):
        await bench.pass_time(0.1)
        assert all(bench.driven)
    assert bench.q_deg == pytest.approx(before, abs=0.5)
    return new


async def calibration(arm):
    return await arm.do_command({"command": "get_calibration"})


def lowest(arm, joint):
    return arm.rig.servos.calibration[joint].range_min


@pytest.mark.parametrize("form", ["port", "arm"])
async def test_an_arm_comes_back_with_another_file_while_its_gripper_stays(bench, data, form):
    arm = bench.new_arm(calibration_file="a.json")
    gripper = new_gripper(bench, form)
    again = await replaced(bench, arm, lambda: bench.new_arm(calibration_file="b.json"))

    now = await calibration(again)
    assert now["calibration_file"] == str(data / "b.json")
    assert (lowest(again, "shoulder_pan"), lowest(gripper, "gripper")) == (900, 1900)
    state = again.rig.arm.state
    assert state.mode is Mode.HOLDING
    assert state.q_ref == pytest.approx(state.q, abs=0.01)
    goal = JointPositions(values=list(np.degrees(state.q)))
    await bench.in_time(again.move_to_joint_positions(goal))


async def test_a_file_that_the_arm_no_longer_names_is_not_in_force(bench):
    arm = bench.new_arm(calibration_file="a.json")
    new_gripper(bench, "arm")
    bench.world.servo("shoulder_pan").memory.keep(emu.MIN_POSITION, 800)
    again = await replaced(bench, arm, bench.new_arm)

    now = await calibration(again)
    assert now["calibration_file"] == ""
    assert set(now["source"].values()) == {"registers"}
    assert lowest(again, "shoulder_pan") == 800


@pytest.mark.parametrize(
    ("before", "after", "name", "asked"),
    [
        ({"at_end": "release"}, {}, "at_end", "hold"),
        ({"timeout": "5s"}, {"timeout": "2s"}, "timeout", 2.0),
        (
            {"joint_zero_offsets_deg": {"elbow_flex": 1.0}},
            {"joint_zero_offsets_deg": {"elbow_flex": -1.0}},
            "zero_offsets",
            {"elbow_flex": pytest.approx(np.radians(-1.0))},
        ),
        ({"joint_zero_offsets_deg": {"elbow_flex": 1.0}}, {}, "zero_offsets", None),
    ],
)
async def test_an_arm_comes_back_with_other_settings(bench, before, after, name, asked):
    arm = bench.new_arm(**before)
    new_gripper(bench, "arm")
    again = await replaced(bench, arm, lambda: bench.new_arm(**after))

    assert getattr(again.rig.settings, name) == asked
    if name == "zero_offsets":
        zeros = (await calibration(again))["zero"]["elbow_flex"]
        middle = 0.0 if asked is None else -1.0
        assert zeros["middle_deg"] == pytest.approx(middle)


async def test_an_arm_comes_back_with_its_servos_in_another_order(bench):
    arm = bench.new_arm(servo_ids=[2.0, 1.0, 3.0, 4.0, 5.0])
    new_gripper(bench, "arm")
    await bench.in_time(arm.close())
    again = bench.new_arm()

    assert [setup.map.servo_id for setup in again.rig.servos.setups.values()] == [1, 2, 3, 4, 5, 6]
    assert again.rig.arm.state.mode is Mode.HOLDING


async def test_a_gripper_that_names_its_arm_follows_its_baudrate(bench):
    bench.shut(bench.base)
    bench.base = bench.open(servo_ids=None, gripper_id=None, timeout=None, baudrate=500_000)
    bench.world.disconnect("wrist_roll")  # or the bench would wait for servos
    arm = bench.new_arm(baudrate=500_000)
    gripper = new_gripper(bench, "arm")
    assert arm.rig.not_ready is not None
    with pytest.raises(GRPCError, match="baudrate 500000 and 1000000"):
        bench.new_arm("other")
    bench.shut(bench.base)
    bench.world.connect("wrist_roll")
    await bench.in_time(arm.close())
    again = bench.new_arm()
    await bench.pass_time(2.0)

    assert again.rig.not_ready is gripper.rig.not_ready is None
    assert again.rig.settings.baudrate == 1_000_000


async def test_a_sensor_comes_back_with_a_file(bench, data):
    arm, sensor = bench.new_arm(), bench.new_sensor()
    again = await replaced(bench, sensor, lambda: bench.new_sensor(calibration_file="b.json"))

    assert (await again.get_status())["calibration_file"] == str(data / "b.json")
    assert (await calibration(arm))["calibration_file"] == str(data / "b.json")
    assert lowest(arm, "shoulder_pan") == 900
    once_more = await replaced(bench, again, lambda: bench.new_sensor())
    assert (await once_more.get_status())["calibration_file"] == str(
        data / "so101_calibration.json"
    )
    assert (await calibration(arm))["calibration_file"] == ""


async def test_an_arm_that_was_limp_stays_limp(bench):
    arm = bench.new_arm(calibration_file="a.json")
    bench.new_gripper()
    await bench.pass_time(0.5)
    await arm.do_command({"command": "set_torque", "enable": False})
    await bench.in_time(arm.close())
    again = bench.new_arm(calibration_file="b.json")
    await bench.pass_time(0.5)

    assert lowest(again, "shoulder_pan") == 900
    assert not any(bench.driven)


async def test_another_file_waits_for_the_end_of_a_motion(bench, caplog):
    arm = bench.new_arm(calibration_file="a.json")
    gripper = bench.new_gripper()
    await bench.pass_time(0.5)
    opening = await bench.start(gripper.open(), lambda: gripper.rig.gripper.is_moving)
    await bench.in_time(arm.close(), 0.01)
    again = bench.build(HardwareArm, "arm", {"port": str(bench.port), "calibration_file": "b.json"})
    asked = bench.in_time(again.get_joint_positions(), 0.01)
    await refused(asked, Status.UNAVAILABLE, "is moving, so nothing else on the port")
    assert lowest(again, "shoulder_pan") == 950
    assert "new settings are not in force yet" in caplog.text
    await bench.in_time(opening)
    await bench.in_time(again.get_joint_positions())
    assert lowest(again, "shoulder_pan") == 900
    assert again.rig.not_ready is gripper.rig.not_ready is None
    await bench.in_time(again.close())


async def test_a_silent_jaw_does_not_keep_the_arm_from_its_new_file(bench):
    arm = bench.new_arm(calibration_file="a.json")
    gripper = new_gripper(bench, "arm")
    bench.world.disconnect("gripper")
    await bench.pass_time(0.5)
    await bench.in_time(arm.close())
    again = bench.new_arm(calibration_file="b.json")

    assert again.rig.not_ready is None
    assert lowest(again, "shoulder_pan") == 900
    with pytest.raises(GRPCError, match="no reply from servo 6"):
        await bench.in_time(gripper.open())
    await bench.in_time(again.get_joint_positions())
    bench.world.connect("gripper")
    await bench.pass_time(1.5)
    await bench.in_time(gripper.open())
    assert lowest(gripper, "gripper") == 1900


async def test_an_arm_with_a_silent_servo_is_not_used_with_the_file_from_before(bench):
    arm = bench.new_arm(calibration_file="a.json")
    gripper = bench.new_gripper()
    bench.world.disconnect("wrist_roll")
    await bench.in_time(arm.close())
    again = bench.new_arm(calibration_file="b.json")

    assert "no reply from servo 5 (wrist_roll)" in again.rig.not_ready
    assert gripper.rig.not_ready is None
    bench.world.connect("wrist_roll")
    await bench.pass_time(1.5)
    await bench.in_time(again.get_joint_positions())
    assert lowest(again, "shoulder_pan") == 900


async def test_servos_that_nobody_asks_for_any_more_are_not_driven_when_they_answer(bench):
    bench.world.disconnect("wrist_roll")
    sensor, arm = bench.new_sensor(), bench.new_arm()
    await bench.pass_time(0.5)
    assert arm.rig.not_ready is not None
    await bench.in_time(arm.close())
    await bench.pass_time(1.5)
    bench.world.connect("wrist_roll")
    await bench.pass_time(2.5)
    assert not any(bench.driven)
    assert len((await sensor.do_command({"command": "get_current_positions"}))["positions"]) == 6
    again = bench.new_arm()
    await bench.pass_time(1.0)
    assert all(bench.driven)
    assert again.rig.arm.state.mode is Mode.HOLDING


async def test_an_arm_that_has_left_is_held_while_the_sensor_changes(bench):
    arm, sensor = bench.new_arm(calibration_file="a.json"), bench.new_sensor()
    await bench.pass_time(0.5)
    await bench.in_time(arm.close())
    await replaced(bench, sensor, lambda: bench.new_sensor(calibration_file="b.json"))
    assert bench.base.arm.state.mode is Mode.HOLDING
    again = bench.new_arm()
    await bench.pass_time(0.5)
    assert lowest(again, "shoulder_pan") == 900
    assert again.rig.arm.state.mode is Mode.HOLDING


# Two components that contradict each other


@pytest.mark.parametrize("arm_first", [True, False])
async def test_the_arms_file_counts_and_the_log_names_both(bench, data, caplog, arm_first):
    builders = [
        lambda: bench.new_arm(calibration_file="a.json"),
        lambda: bench.new_sensor(calibration_file="b.json"),
    ]
    with caplog.at_level(logging.WARNING):
        one, two = (build() for build in (builders if arm_first else reversed(builders)))
    arm, sensor = (one, two) if arm_first else (two, one)
    await bench.pass_time(0.5)

    assert lowest(arm, "shoulder_pan") == 950
    assert (await calibration(arm))["calibration_file"] == str(data / "a.json")
    assert (await sensor.get_status())["calibration_file"] == str(data / "a.json")
    (warning,) = [text for text in caplog.messages if "b.json" in text]
    for words in ("a.json", "because the arm names it", "the same calibration_file"):
        assert words in warning
