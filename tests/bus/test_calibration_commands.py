"""The calibration sensor takes emulated kits to calibrated arms, by the published commands.

A scripted hand moves the servos; not tried on a real arm yet.
"""

import asyncio
import json

import pytest
from grpclib import Status
from harness.fake_parent import CALIBRATION, SENSOR, config_of, until
from harness.held_calibration import put
from harness.in_process_module import do, refused

from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.world import no_gravity
from so101_motion.viam.models.calibration import So101Calibration

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
IDS = {joint: i for i, joint in enumerate(JOINTS, start=1)}
OFFERED = {
    "idle": ["start"],
    "started": ["set_homing", "abort"],
    "homing_position": ["start_range_recording", "abort"],
    "range_recording": ["stop_range_recording", "abort"],
    "completed": ["save_calibration", "start", "abort"],
}


@pytest.fixture
def options(options):
    return {"calibrated": False, **options}


@pytest.fixture
def bench(models, data):
    """A new kit without weight, with nothing but a sensor on it."""
    models.world.gravity = no_gravity
    return models


JOINT_KEYS = {
    "id", "current_position", "homing_offset", "range_min", "range_max", "is_completed",
    "expected_range_degs",
}  # fmt: skip


def offsets(bench):
    return {s.joint.name: reg.decode_offset(s.memory.raw(reg.OFFSET)) for s in bench.world.servos}


async def test_every_command_of_the_workflow_answers_as_published(bench, tmp_path):
    put(bench.world, 0.4)
    port = str(bench.port)
    config = config_of(SENSOR, CALIBRATION, {"port": port}, "calibration")
    assert So101Calibration.validate_config(config)[0] == []
    attributes = {"baudrate": 1000000, "timeout": "5s", "calibration_file": "my_awesome_arm.json"}
    sensor = bench.new_sensor(**attributes)
    file = tmp_path / "my_awesome_arm.json"

    async def check(state):
        await bench.pass_time(0.3)
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
    output = bench.world.servo("elbow_flex").drive.shaft.output
    from_middle = (output - 2048.0) * 360.0 / 4096.0  # there are no limits yet
    assert at["degrees"] == pytest.approx(from_middle, abs=0.1)

    answer = await do(sensor, "start")
    assert answer.keys() == {"success", "state", "message"}
    assert (answer["success"], answer["state"]) == (True, "started")
    assert not any(bench.driven)
    put(bench.world, 0.5)
    await check("started")

    answer = await do(sensor, "set_homing")
    assert answer["homing_offsets"] == {
        str(IDS[joint]): offset for joint, offset in offsets(bench).items()
    }
    now = await check("homing_position")
    positions = [joint["current_position"] for joint in now["joints"].values()]
    assert positions == pytest.approx([2047] * 6, abs=1)

    answer = await do(sensor, "start_range_recording")
    assert answer.keys() == {"success", "state", "message"}
    for share in (0.5, 0.2, 0.0, 0.3, 0.6, 0.9, 1.0, 0.7):
        put(bench.world, share)
        await bench.pass_time(0.05)
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
    assert all(bench.driven)
    await check("idle")

    entries = json.loads(file.read_text())
    assert list(entries) == list(JOINTS)
    for joint, entry in entries.items():
        assert list(entry) == [
            "id", "drive_mode", "homing_offset", "range_min", "range_max", "norm_mode",
        ]  # fmt: skip
        assert entry["norm_mode"] == (1 if joint == "gripper" else 3)
        assert entry["homing_offset"] == offsets(bench)[joint]


async def motor_setup(sensor):
    return (await sensor.get_readings())["motor_setup"]


async def is_scanning(sensor):
    return (await motor_setup(sensor))["status"].startswith(("scanning", "listening"))


async def has_scanned(sensor):
    return "answer" in (await motor_setup(sensor))["status"]


def connect_only(bench, *joints):
    for joint in JOINTS:
        (bench.world.connect if joint in joints else bench.world.disconnect)(joint)


@pytest.mark.emulated(ids=dict.fromkeys(range(1, 7), 1))
async def test_every_command_of_the_motor_setup_answers_as_published(bench):
    connect_only(bench, "gripper")
    await bench.pass_time(1.0)
    sensor = bench.new_sensor()
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
    for changes, status, says in (
        (wrong, Status.FAILED_PRECONDITION, "has the id 1, not 3"),
        ({"target_id": 5}, Status.INVALID_ARGUMENT, "gripper has the id 6"),
        ({"current_id": 1.5}, Status.INVALID_ARGUMENT, "whole number"),
    ):
        await refused(do(sensor, "motor_setup_assign_id", **gripper, **changes), status, says)

    # The documentation's own example: the rate is a hint, and here a wrong one.
    wrong["current_id"] = 1
    done = await do(sensor, "motor_setup_assign_id", **gripper, **wrong)
    assert (done["old_id"], done["new_id"], done["new_baudrate"]) == (1, 6, 1_000_000)
    assert done["success"] is True
    assert bench.world.servo("gripper").memory.raw(reg.ID) == 6
    assert (await motor_setup(sensor))["step"] == 1
    skipped = await do(sensor, "motor_setup_skip", motor_name="wrist_roll")
    assert "wrist_flex" in skipped["next_step"]

    # A client that goes away has its scan finished; readings never wait for one.
    with bench.world.lock:  # no servo answers meanwhile
        scan = asyncio.ensure_future(do(sensor, "motor_setup_scan_bus"))
        await until(lambda: is_scanning(sensor))
        assert (await motor_setup(sensor))["in_progress"] is True
        scan.cancel()
    await until(lambda: has_scanned(sensor))
    scanned = await do(sensor, "motor_setup_scan_bus")
    assert (scanned["servos_found"], scanned["unexpected_count"]) == (1, 0)
    assert scanned["servos"] == [
        {"id": 6, "model": "sts3215", "status": "expected", "expected_name": "gripper",
         "baudrate": 1_000_000}
    ]  # fmt: skip

    verdict = await do(sensor, "motor_setup_verify")
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

    connect_only(bench, "gripper", "wrist_roll")
    await bench.pass_time(1.0)
    asked = do(sensor, "motor_setup_discover", **gripper)
    await refused(asked, Status.FAILED_PRECONDITION, "connect only the servo of gripper")
    assert (await motor_setup(sensor))["motors"]["gripper"]["state"] == "failed"
