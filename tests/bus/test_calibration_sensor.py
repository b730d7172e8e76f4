"""The calibration sensor on a port that an arm and a gripper use as well."""

import asyncio

import numpy as np
import pytest
from grpclib import GRPCError
from harness.emulated_rig import ModelBench
from harness.held_calibration import put
from harness.in_process_module import do, refused
from viam.components.arm import JointPositions

from so101_motion.calib.record import store
from so101_motion.calib.record.record import JOINTS
from so101_motion.common.modes import Mode
from so101_motion.drivers.emulator import registers as emu

HOME = (0.0, -0.8, 0.8, 1.0, 0.0, 0.3)


@pytest.fixture
async def bench(data, planning_process):
    bench = ModelBench(data, q_start=HOME)
    yield bench
    await bench.end()


async def record(bench, sensor, joints=JOINTS, *, middle=0.5):
    """Everything before it is saved."""
    await do(sensor, "start")
    put(bench.world, middle, joints)
    await do(sensor, "set_homing")
    await do(sensor, "start_range_recording")
    for share in (0.5, 0.2, 0.0, 0.3, 0.6, 0.9, 1.0, 0.7):
        put(bench.world, share, joints)
        await bench.pass_time(0.05)
    for servo, q in zip(bench.world.servos, HOME, strict=True):
        servo.drive.shaft.put(servo.drive.to_ticks(q))
    await do(sensor, "stop_range_recording")


def held(bench):
    """What the servos hold, and whether they are driven."""
    rows = (emu.OFFSET, emu.MIN_POSITION, emu.MAX_POSITION, emu.TORQUE_ENABLE)
    return [[servo.memory.raw(row) for row in rows] for servo in bench.world.servos]


# Sharing the port


@pytest.mark.parametrize("first", ["sensor", "arm", "gripper"])
async def test_it_shares_the_port_whoever_comes_first(bench, first):
    builders = {
        "sensor": lambda: bench.new_sensor(timeout="5s"),
        "arm": bench.new_arm,
        "gripper": bench.new_gripper,
    }
    built = {first: builders.pop(first)()}
    built |= {name: build() for name, build in builders.items()}
    await bench.pass_time(0.5)

    assert (await do(built["arm"], "controller_status"))["ref_count"] == 4, "and the bench itself"
    assert built["arm"].rig.arm.state.mode is Mode.HOLDING
    positions = (await do(built["sensor"], "get_current_positions"))["positions"]
    assert len(positions) == 6
    q = (await built["arm"].get_joint_positions()).values
    assert positions["elbow_flex"]["degrees"] == pytest.approx(q[2], abs=0.05)


# Calibrating beside an arm


async def test_a_running_arm_waits_and_then_has_the_new_calibration(bench):
    arm, gripper, sensor = bench.new_arm(), bench.new_gripper(), bench.new_sensor()
    await bench.pass_time(1.0)
    before = (await do(arm, "get_calibration"))["calibration"]
    await record(bench, sensor)
    goal = JointPositions(values=list(np.degrees(HOME[:5])))
    for call in (arm.move_to_joint_positions(goal), gripper.open(), arm.set_manual_mode(True)):
        with pytest.raises(GRPCError, match="in use for calibration; finish or abort that"):
            await bench.in_time(call)
    await refused(do(sensor, "motor_setup_scan_bus"), None, "in use for calibration")
    assert "in use for calibration" in (await do(arm, "diagnose"))["error"]
    saved = await do(sensor, "save_calibration")

    assert saved["torque_enabled"] is True
    assert "The joints are held" in saved["message"]
    assert all(bench.driven)
    after = await do(arm, "get_calibration")
    assert after["calibration"] != before
    assert after["calibration_file"] == saved["calibration_file"]
    assert after["zero"]["elbow_flex"]["by"] == "stops"
    await bench.in_time(arm.move_to_joint_positions(goal))
    assert bench.q_deg[:5] == pytest.approx(np.degrees(HOME[:5]), abs=1.5)


@pytest.mark.parametrize("holds", [True, False])
async def test_a_calibration_that_is_aborted_leaves_no_trace(bench, data, holds):
    arm, sensor = bench.new_arm(), bench.new_sensor()
    await do(arm, "set_torque", enable=holds)
    await bench.pass_time(1.0)
    before = held(bench)
    await record(bench, sensor)
    assert held(bench) != before
    await do(sensor, "start")  # anew: what was held before the first is still known
    assert not any(bench.driven)
    put(bench.world, 0.4)
    await do(sensor, "set_homing")
    answer = await do(sensor, "abort")

    assert (answer["state"], answer["torque_enabled"]) == ("idle", holds)
    assert ("limp" in answer["message"]) is not holds
    assert held(bench) == before
    assert arm.rig.arm.state.mode is (Mode.HOLDING if holds else Mode.LIMP)
    assert [path.name for path in data.glob("*calib*")] == []


@pytest.mark.parametrize("with_arm", [True, False])
async def test_removing_the_sensor_half_way_puts_everything_back(bench, with_arm):
    if with_arm:
        bench.new_arm()
        await bench.pass_time(0.5)
    before = held(bench)
    sensor = bench.new_sensor()
    await record(bench, sensor)
    await sensor.close()
    await sensor.close()

    assert held(bench) == before


async def test_only_the_joints_it_was_given_are_saved_as_soon_as_all_of_them_answer(bench, data):
    arm, sensor = bench.new_arm(), bench.new_sensor(servo_ids=[6.0, 3.0])
    await bench.pass_time(0.5)
    before, joints = held(bench), {"elbow_flex", "gripper"}
    await record(bench, sensor, joints)
    bench.world.disconnect("gripper")
    says = (await refused(do(sensor, "save_calibration"), None, "no reply")).message
    now = await sensor.get_readings()
    assert (now["last_save_error"], now["calibration_state"]) == (says, "completed")
    assert set(now["joints"]) == joints
    bench.world.connect("gripper")
    await bench.pass_time(1.2)

    assert (await do(sensor, "save_calibration"))["joints_calibrated"] == 2
    assert (await sensor.get_readings())["last_save_error"] == ""
    assert set(store.read(data / "so101_calibration.json").calibration) == joints
    unchanged = [i for i, row in enumerate(held(bench)) if row == before[i]]
    assert unchanged == [0, 1, 3, 4]
    sources = (await do(arm, "get_calibration"))["source"]
    assert (sources["elbow_flex"], sources["wrist_flex"]) == ("file", "registers")


# When things go wrong


async def test_a_servo_that_is_missing_at_the_start_is_named_and_the_arm_stays_up(bench):
    arm, sensor = bench.new_arm(), bench.new_sensor()
    await bench.pass_time(0.5)
    bench.world.disconnect("gripper")
    error = await refused(do(sensor, "start"), None, "no reply from servo 6 (gripper)")
    now = await sensor.get_readings()

    assert (now["calibration_state"], now["error"]) == ("error", error.message)
    assert now["available_commands"] == ["reset", "start"]
    assert bench.driven[:5] == [True] * 5
    assert arm.rig.arm.state.mode is Mode.HOLDING
    assert (await do(sensor, "reset"))["state"] == "idle"


async def test_a_client_that_goes_away_leaves_no_half_step(bench):
    sensor = bench.new_sensor()
    for command, state in (("start", "started"), ("set_homing", "homing_position")):
        step = asyncio.create_task(do(sensor, command))
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        step.cancel()
        with pytest.raises(asyncio.CancelledError):
            await step
        now = await sensor.get_readings()
        assert (now["calibration_state"], "error" in now) == (state, False)


# The steps of a setup


async def test_the_steps_of_a_setup_are_reported_with_what_is_left_of_each(bench):
    sensor = bench.new_sensor()
    await bench.pass_time(0.3)
    told = await do(sensor, "setup_steps", workflow="calibration")
    assert told["title"] == "Calibration Only"
    names = [step["name"] for step in told["steps"]]
    assert names == ["connect", "chain", "pose", "record", "save", "test", "configure"]
    assert told["next_step"] == "chain"

    verdict = await do(sensor, "motor_setup_verify")
    assert (verdict["success"], verdict["all_ok"]) == (True, True)
    assert "error" not in verdict
    await record(bench, sensor)
    verdicts = {
        step["name"]: step["verdict"] for step in (await do(sensor, "setup_steps"))["steps"]
    }
    assert verdicts["chain"] == verdicts["pose"] == verdicts["record"] == "ok"
    assert verdicts["save"] == "fail"

    await do(sensor, "save_calibration")
    assert "next_step" not in await do(sensor, "setup_steps")
