"""The real executable takes emulated kits to calibrated arms, by the published commands.

The servos are in this process and a scripted hand moves them; not tried on a real arm yet.
"""

import asyncio
import json

import pytest
from grpclib import GRPCError, Status
from harness.emulated_kit import NEW, emulated_kit
from harness.fake_parent import CALIBRATION, SENSOR, running_module, until

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
IDS = {joint: i for i, joint in enumerate(JOINTS, start=1)}
OFFERED = {
    "idle": ["start"],
    "started": ["set_homing", "abort"],
    "homing_position": ["start_range_recording", "abort"],
    "range_recording": ["stop_range_recording", "abort"],
    "completed": ["save_calibration", "start", "abort"],
}


@pytest.fixture(autouse=True)
def data(tmp_path, monkeypatch):
    """The module's data directory."""
    for name, folder in (("VIAM_MODULE_DATA", "data"), ("XDG_DATA_HOME", "home")):
        (tmp_path / folder).mkdir()
        monkeypatch.setenv(name, str(tmp_path / folder))
    return tmp_path / "data"


async def do(resource, command, **arguments):
    return await resource.do_command({"command": command, **arguments})


async def refused(resource, command, **arguments):
    """What a command is refused with: status and sentence."""
    with pytest.raises(GRPCError) as caught:
        await do(resource, command, **arguments)
    return caught.value.status, caught.value.message


async def samples(sensor, count):
    """Wait until the joints have been read ``count`` times more."""
    begin = (await sensor.get_readings())["position_samples"]

    async def are_in():
        return (await sensor.get_readings())["position_samples"] >= begin + count

    await until(are_in)


SCANNING = ("scanning", "listening")
"""How the status begins during a scan."""


JOINT_KEYS = {
    "id", "current_position", "homing_offset", "range_min", "range_max", "is_completed",
    "expected_range_degs",
}  # fmt: skip


async def test_every_command_of_the_workflow_answers_as_published(tmp_path, data):
    with emulated_kit(tmp_path) as kit:
        kit.put(0.4)
        async with running_module() as (module, _, _):
            answer = await module.validate(SENSOR, CALIBRATION, {"port": kit.port})
            assert list(answer.dependencies) == []
            attributes = {
                "port": kit.port, "calibration_file": "my_awesome_arm.json",
                "baudrate": 1000000, "timeout": "5s",
            }  # fmt: skip
            sensor = await module.add(SENSOR, CALIBRATION, attributes, "calibration")
            file = data / "my_awesome_arm.json"

            async def check(state):
                await until(lambda: has_positions(sensor))
                now = await sensor.get_readings()
                assert now["calibration_state"] == state
                assert now["available_commands"] == OFFERED[state]
                assert now["servo_count"] == 6
                assert now["instruction"]
                assert "error" not in now
                assert now["calibration_file"] == str(file)
                assert now["motor_setup"]["in_progress"] is False
                assert now["motor_setup"]["step"] == 0
                assert now["motor_setup"]["status"] == "Motor setup ready"
                assert {joint: now["joints"][joint]["id"] for joint in JOINTS} == IDS
                assert all(joint.keys() >= JOINT_KEYS for joint in now["joints"].values())
                assert ("position_samples" in now) is (state in ("range_recording", "completed"))
                return now

            now = await check("idle")
            where = await do(sensor, "get_current_positions")
            assert where.keys() == {"success", "positions", "silent"}
            at = where["positions"]["elbow_flex"]
            assert at.keys() == {"servo_id", "raw_position", "radians", "degrees"}
            assert at["raw_position"] == now["joints"]["elbow_flex"]["current_position"]
            assert at["degrees"] == pytest.approx(-102.4 + 0.4 * 193.2, abs=0.1), "no limits yet"

            answer = await do(sensor, "start")
            assert answer.keys() == {"success", "state", "message"}
            assert (answer["success"], answer["state"]) == (True, "started")
            assert not any(kit.driven)
            kit.put(0.5)
            await until(lambda: is_at(sensor, "elbow_flex", kit))
            await check("started")

            answer = await do(sensor, "set_homing")
            assert answer["homing_offsets"] == {
                str(IDS[joint]): offset for joint, offset in kit.offsets.items()
            }
            now = await check("homing_position")
            positions = [joint["current_position"] for joint in now["joints"].values()]
            assert positions == pytest.approx([2047] * 6, abs=1)

            answer = await do(sensor, "start_range_recording")
            assert answer.keys() == {"success", "state", "message"}
            for share in (0.5, 0.2, 0.0, 0.3, 0.6, 0.9, 1.0, 0.7):
                kit.put(share)
                await samples(sensor, 5)
            now = await check("range_recording")
            assert now["recording_time_seconds"] > 0.2
            elbow = now["joints"]["elbow_flex"]
            assert elbow["is_completed"] is True
            assert elbow["verdict"] == "complete"
            assert elbow["recorded_range_degs"] == pytest.approx(193.2, abs=0.2)

            answer = await do(sensor, "stop_range_recording")
            assert answer["state"] == "completed"
            assert answer["samples_collected"] >= now["position_samples"]
            assert answer["recording_duration"] >= now["recording_time_seconds"]
            found = answer["ranges"]["elbow_flex"]
            assert found["range"] == found["max"] - found["min"]
            await check("completed")

            answer = await do(sensor, "save_calibration")
            assert (answer["state"], answer["joints_calibrated"]) == ("idle", 6)
            assert answer["calibration_file"] == str(file)
            assert answer["torque_enabled"] is True
            assert all(kit.driven)
            await until(lambda: are_completed(sensor))
            await check("idle")

            entries = json.loads(file.read_text())
            assert list(entries) == list(JOINTS)
            for joint, entry in entries.items():
                assert list(entry) == [
                    "id", "drive_mode", "homing_offset", "range_min", "range_max", "norm_mode",
                ]  # fmt: skip
                assert entry["norm_mode"] == (1 if joint == "gripper" else 3)
                assert entry["homing_offset"] == kit.offsets[joint]


async def are_completed(sensor):
    joints = (await sensor.get_readings())["joints"]
    return all(joint["is_completed"] for joint in joints.values())


async def has_positions(sensor):
    joints = (await sensor.get_readings())["joints"]
    return all("current_position" in joint for joint in joints.values())


async def is_at(sensor, joint, kit):
    """Whether the readings show a joint where it is."""
    truth = round(kit.world.servo(joint).drive.shaft.output) - kit.offsets[joint]
    return (await sensor.get_readings())["joints"][joint].get("current_position") == truth


async def heard(ask, is_heard):
    """The answer to ``ask()``; asked again while a busy machine keeps servos from being heard."""
    for _ in range(10):
        answer = await ask()
        if is_heard(answer):
            break
    return answer


async def motor_setup(sensor):
    return (await sensor.get_readings())["motor_setup"]


async def test_every_command_of_the_motor_setup_answers_as_published(tmp_path):
    with emulated_kit(tmp_path, ids=NEW) as kit:
        await kit.connect_only("gripper")
        async with running_module() as (module, _, _):
            sensor = await module.add(SENSOR, CALIBRATION, {"port": kit.port}, "calibration")
            gripper = {"motor_name": "gripper"}
            found = await do(sensor, "motor_setup_discover", **gripper)
            assert found.keys() >= {
                "success", "motor_name", "current_id", "target_id", "model", "found_baudrate",
                "status",
            }  # fmt: skip
            assert (found["current_id"], found["target_id"]) == (1, 6)
            assert (found["model"], found["found_baudrate"]) == ("sts3215", 1_000_000)
            setup = await motor_setup(sensor)
            assert (setup["in_progress"], setup["step"]) == (True, 0)
            assert setup["motors"]["gripper"]["state"] == "found"
            assert setup["next_step"].startswith("assign gripper")

            wrong = {"current_id": 3, "target_id": 6, "current_baudrate": 57600}
            status, says = await refused(sensor, "motor_setup_assign_id", **gripper, **wrong)
            assert status is Status.FAILED_PRECONDITION
            assert "has the id 1, not 3" in says
            status, says = await refused(sensor, "motor_setup_assign_id", **gripper, target_id=5)
            assert (status, "gripper has the id 6" in says) == (Status.INVALID_ARGUMENT, True)
            status, says = await refused(sensor, "motor_setup_assign_id", **gripper, current_id=1.5)
            assert (status, "whole number" in says) == (Status.INVALID_ARGUMENT, True)

            # The documentation's own example: the rate is a hint, and here a wrong one.
            wrong["current_id"] = 1
            done = await do(sensor, "motor_setup_assign_id", **gripper, **wrong)
            assert (done["old_id"], done["new_id"], done["new_baudrate"]) == (1, 6, 1_000_000)
            assert done["success"] is True
            assert kit.ids[5] == 6
            assert (await motor_setup(sensor))["step"] == 1
            skipped = await do(sensor, "motor_setup_skip", motor_name="wrist_roll")
            assert "wrist_flex" in skipped["next_step"]

            # A client that goes away has its scan finished; readings never wait for one.
            looks = 0
            while not looks:  # once, unless a busy machine looked elsewhere all the time
                scan = asyncio.ensure_future(do(sensor, "motor_setup_scan_bus"))
                setup = await motor_setup(sensor)
                while not scan.done() or setup["status"].startswith(SCANNING):
                    if setup["status"].startswith(SCANNING):
                        assert setup["in_progress"] is True
                        looks += 1
                        scan.cancel()
                    setup = await motor_setup(sensor)
            assert "answer" in (await motor_setup(sensor))["status"]
            scanned = await heard(
                lambda: do(sensor, "motor_setup_scan_bus"),
                lambda answer: answer["servos_found"] == 1,
            )
            assert (scanned["servos_found"], scanned["unexpected_count"]) == (1, 0)
            assert scanned["servos"] == [
                {"id": 6, "model": "sts3215", "status": "expected", "expected_name": "gripper",
                 "baudrate": 1_000_000}
            ]  # fmt: skip

            verdict = await heard(
                lambda: do(sensor, "motor_setup_verify"),
                lambda answer: answer["motors"]["gripper"]["status"] == "ok",
            )
            assert verdict["success"] is False
            assert verdict["error"] == verdict["status"] != ""
            assert {joint: motor["id"] for joint, motor in verdict["motors"].items()} == IDS
            assert verdict["motors"]["gripper"]["status"] == "ok"
            assert verdict["motors"]["gripper"]["model"] == "sts3215"
            assert verdict["motors"]["elbow_flex"]["status"] == "not_responding"
            assert verdict["motors"]["elbow_flex"]["error"]

            answer = await do(sensor, "motor_setup_reset_status")
            assert answer == {"success": True, "status": "Motor setup ready"}
            setup = await motor_setup(sensor)
            assert (setup["in_progress"], setup["step"]) == (False, 0)

            await kit.connect_only("gripper", "wrist_roll")
            status, says = await refused(sensor, "motor_setup_discover", **gripper)
            assert status is Status.FAILED_PRECONDITION
            assert "connect only the servo of gripper" in says
            assert (await motor_setup(sensor))["motors"]["gripper"]["state"] == "failed"
