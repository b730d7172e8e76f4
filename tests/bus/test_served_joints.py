"""An arm that rests outside the limits viam-server knows: the machine goes on, and is told."""

import math
from dataclasses import replace

import numpy as np
import pytest
from harness.emulated_rig import arm_client
from viam.components.arm import JointPositions

from so101_motion.calib.record import record, store
from so101_motion.control.limit_recovery import FARTHEST_OUT
from so101_motion.viam.models.hardware_arm import served_joints, served_limits, served_remarks

ELBOW = 2
AT_ITS_STOP = (0.0, 0.0, math.radians(90.7), math.radians(-60.0), 0.0, 0.0)
"""The elbow is at its upper stop, 90.8 deg. With zero in the middle of the joint's travel, as
without a calibration of ours, that reads as 96.6."""


@pytest.fixture
async def client(models):
    arm = models.new_arm(floor_z_mm=-500)  # the hand hangs low there
    await models.pass_time(1.0)
    async with arm_client(arm) as client:
        yield client


@pytest.mark.emulated(q_start=AT_ITS_STOP)
async def test_a_joint_outside_is_reported_at_its_limit_and_its_place_is_in_the_status(
    models, client, caplog
):
    lower, upper = (np.degrees(each) for each in served_limits())
    for _ in range(3):
        values = list((await client.get_joint_positions()).values)
        assert values[ELBOW] == pytest.approx(upper[ELBOW])
        assert np.all(values <= upper)
        assert np.all(values >= lower)
    status = await client.get_status()
    assert status["joint_positions_deg"]["elbow_flex"] == pytest.approx(96.5, abs=0.5)
    (note,) = status["notes"]
    for words in ("elbow_flex is at 96.", "90.8 deg", "GetJointPositions says 90.8"):
        assert words in note
    assert caplog.text.count("outside the limits that viam-server knows") == 1, "said once"

    await models.in_time(client.move_through_joint_positions([
        JointPositions(values=values), JointPositions(values=[*values[:ELBOW], 60.0, *values[3:]])
    ]))  # fmt: skip
    values = list((await client.get_joint_positions()).values)
    assert values[ELBOW] == pytest.approx(60.0, abs=0.5)
    assert (await client.get_status())["notes"] == []


@pytest.mark.emulated(calibrated=False)
async def test_the_status_names_joints_outside_their_range_and_those_never_calibrated(
    models, tmp_path
):
    entries = {
        joint: replace(record.default(joint), id=i)
        for i, joint in enumerate(record.JOINTS, start=1)
        if joint != "elbow_flex"
    }
    for joint in ("shoulder_pan", "gripper"):  # they stand at 2048
        entries[joint] = replace(entries[joint], range_min=2130, range_max=3000)
    store.save(tmp_path / "calibration.json", entries)
    arm = models.new_arm(calibration_file=str(tmp_path / "calibration.json"))
    models.new_gripper(calibration_file=str(tmp_path / "calibration.json"))
    await models.pass_time(1.0)
    async with arm_client(arm) as client:
        status = await client.get_status()
    assert status["uncalibrated"] == ["elbow_flex"]
    outside = status["out_of_range"]
    assert set(outside) == {"shoulder_pan", "gripper"}
    for each in outside.values():
        off_deg = each["limit_deg"] - each["at_deg"]
        assert off_deg == pytest.approx((2130 - 2048) * 360.0 / 4096.0, abs=0.6)


def test_a_joint_far_outside_is_reported_where_it_is():
    _, upper = served_limits()
    beyond = upper + np.array([0.0, 0.0, FARTHEST_OUT + 0.01, 0.0, 0.0])
    assert served_joints(beyond) == pytest.approx(beyond)
    (remark,) = served_remarks(beyond)
    assert "elbow_flex" in remark
    assert "moves no arm" in remark
    assert "GetJointPositions" not in remark
