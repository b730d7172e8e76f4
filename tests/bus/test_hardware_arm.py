import numpy as np
import pytest
from grpclib import GRPCError, Status
from harness.emulated_rig import arm_client
from harness.in_process_module import joints, refused

from so101_motion.calib.record import record, store
from so101_motion.drivers.emulator import registers as emu
from so101_motion.viam.models.hardware_arm import HardwareArm


@pytest.fixture
def arm(models):
    return models.new_arm(acceleration_degs_per_sec_per_sec=300.0)


@pytest.fixture
async def client(arm, models):
    await models.pass_time(1.0)
    async with arm_client(arm) as client:
        yield client


# The published module's requests


async def ask(client, models, **request):
    return await models.in_time(client.do_command(request))


async def test_torque_goes_off_and_on_without_a_jump(models, client):
    assert await ask(client, models, command="set_torque", enable=False) == {"success": True}
    assert await client.get_manual_mode()
    assert (await client.get_status())["state"] == "limp"
    assert models.world.servo("shoulder_pan").memory.raw(emu.TORQUE_ENABLE) == 0
    assert await ask(client, models, command="set_torque", enable=True) == {"success": True}
    before = models.q_deg
    await models.pass_time(1.0)

    assert models.world.servo("shoulder_pan").memory.raw(emu.TORQUE_ENABLE) == 1
    assert models.q_deg[[0, 4, 5]] == pytest.approx(before[[0, 4, 5]], abs=0.35)
    assert models.q_deg == pytest.approx(before, abs=5.0), "what was falling is caught"
    assert not await client.get_manual_mode()


async def test_servos_can_be_asked_after_in_every_way(models, client):
    assert await ask(client, models, command="ping") == {"success": True}
    seen = await ask(client, models, command="test_servo_communication")
    assert (seen["success"], seen["arm_servo_ids"]) == (True, [1, 2, 3, 4, 5])
    here = (await client.get_joint_positions()).values
    assert np.degrees(seen["positions"]) == pytest.approx(here, abs=0.5)
    status = await ask(client, models, command="controller_status")
    assert f"{models.port}@1000000(refs:2" in status["config"]
    assert (await ask(client, models, command="diagnose"))["servos_found"] == [1, 2, 3, 4, 5, 6]
    models.world.disconnect("wrist_flex")
    await refused(ask(client, models, command="ping"), Status.UNAVAILABLE, "wrist_flex")


async def test_a_port_that_is_gone_is_a_failure_of_diagnose_and_what_is_worth_knowing_is_none(
    models, arm, client
):
    arm.rig.servos.notes = ("the file was restored",)
    models.emulator.unplug()
    await models.pass_time(0.5)
    answer = await ask(client, models, command="diagnose")
    assert (answer["success"], "port" in answer["error"]) == (False, True)
    models.emulator.plug()
    await models.pass_time(3.0)
    answer = await ask(client, models, command="diagnose")

    assert answer["findings"][0] == "the file was restored"
    assert "the port went away 1 times" in answer["findings"][-1]
    assert (answer["success"], answer["error"]) == (True, "")


async def test_verify_config_compares_servos_and_calibration(models, client):
    assert await ask(client, models, command="verify_config") == {"success": True, "error": ""}
    models.world.servo("elbow_flex").memory.set(emu.MODE, 1)
    answer = await ask(client, models, command="verify_config")

    assert answer["success"] is False
    assert "elbow_flex: operating_mode is 1" in answer["error"]


async def test_reinitialize_sets_everything_up_again(models, client):
    models.world.servo("elbow_flex").memory.set(emu.MODE, 1)
    before = (await ask(client, models, command="health"))["joints"]["elbow_flex"]["answers"]
    answer = await ask(client, models, command="reinitialize", retries=2)

    assert answer == {"success": True, "error": "", "retries": 2}
    told = (await ask(client, models, command="health"))["joints"]["elbow_flex"]
    assert told["answers"] > before, "what is counted is counted on"
    assert models.world.servo("elbow_flex").memory.raw(emu.MODE) == 0
    models.world.disconnect("elbow_flex")
    answer = await ask(client, models, command="reinitialize", retries=1)
    assert answer["success"] is False
    assert "elbow_flex" in answer["error"]


async def test_the_calibration_is_reported_with_its_source(models, client):
    answer = await ask(client, models, command="get_calibration")
    pan = answer["calibration"]["shoulder_pan"]

    assert answer["success"] is True
    assert pan == {
        "id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": 737, "range_max": 3452,
        "norm_mode": 3,
    }  # fmt: skip
    assert answer["calibration"]["gripper"]["norm_mode"] == 1
    assert answer["source"]["shoulder_pan"] == "registers"
    assert answer["zero"]["shoulder_pan"] == {"by": "middle", "middle_deg": 0.0}
    assert "gripper" not in answer["zero"]


async def test_reloading_reads_the_very_file_that_was_configured(models, monkeypatch):
    monkeypatch.setenv("VIAM_MODULE_DATA", str(models.port.parent))
    file = models.port.parent / "arm.json"
    store.save(file, {"shoulder_pan": record.JointCalibration(id=1, range_min=737, range_max=3452)})
    arm = models.new_arm(calibration_file="arm.json")
    async with arm_client(arm) as client:
        store.save(
            file, {"shoulder_pan": record.JointCalibration(id=1, range_min=780, range_max=3452)}
        )
        answer = await ask(client, models, command="reload_calibration")
        assert (answer["success"], answer["calibration_file"]) == (True, str(file))
        calibration = (await ask(client, models, command="get_calibration"))["calibration"]
        assert calibration["shoulder_pan"]["range_min"] == 780
        file.write_text("{")
        answer = await ask(client, models, command="reload_calibration")
        assert (answer["success"], "not JSON" in answer["error"]) == (False, True)


async def test_a_torque_limit_reaches_the_servos(models, client):
    answer = await ask(client, models, command="set_torque_limit", value=600)

    assert answer["set_torque_limit"] == 600
    assert models.world.servo("shoulder_pan").memory.raw(emu.TORQUE_LIMIT) == 600


async def test_closing_the_arm_stops_it_though_the_gripper_stays(models, arm, client):
    gripper = models.new_gripper()
    before = models.q_deg[0]
    move = await models.start(
        client.move_to_joint_positions(joints(90, 0, 0, 0, 0)), lambda: models.q_deg[0] > before + 8
    )
    await models.in_time(arm.close())
    with pytest.raises(GRPCError):
        await move
    here = models.q_deg[0]
    await models.pass_time(1.0)

    assert models.q_deg[0] == pytest.approx(here, abs=1.0)
    assert gripper.rig.users == 2
    assert HardwareArm.here == {}
