"""Where zero is on a running arm, against the emulated servos' truth."""

import json
import math
from dataclasses import replace

import pytest
from harness.emulated_rig import MIDDLES_DEG, arm_client
from harness.held_calibration import hold_calibration

from so101_motion.calib.record import store
from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.common.encoder_zeros import shift
from so101_motion.drivers.emulator.joint_figures import SO101
from so101_motion.rig.joint_setup import Doubt

ARM = JOINTS[:5]
STANDS = (0.3, -0.4, 0.5, -0.2, 0.6, 0.4)
TICKS_PER_RAD = 4096 / math.tau

# Nobody mounts a servo's horn where its encoder reads the middle: some cross the seam.
MOUNTED = tuple(
    replace(joint, zero_ticks=ticks)
    for joint, ticks in zip(SO101, (1930, 2290, 3900, 100, 2600, 2048), strict=True)
)


def swept(joint):
    """What a calibration from stop to stop records of a joint."""
    lower = joint.zero_ticks + joint.lower * TICKS_PER_RAD
    upper = joint.zero_ticks + joint.upper * TICKS_PER_RAD
    offset = (round((lower + upper) / 2) + 1) % 4096 - 2048
    middle = (round((lower + upper) / 2) - offset) % 4096
    return JointCalibration(
        id=JOINTS.index(joint.name) + 1,
        homing_offset=offset,
        range_min=round(middle - (upper - lower) / 2),
        range_max=round(middle + (upper - lower) / 2),
        norm_mode=1 if joint.name == "gripper" else 3,
    )


def saved(file, *, servos=None):
    calibration = {joint.name: swept(joint) for joint in MOUNTED}
    store.save(file, calibration)
    if servos:
        hold_calibration(servos.world, calibration)
    return file


pytestmark = pytest.mark.emulated(joints=MOUNTED, q_start=STANDS, calibrated=False)


def test_servos_as_they_are_sold_are_told_of_in_one_sentence(bench):
    new, jaw = bench.open().servos.notes

    assert new.startswith(
        "shoulder_pan, shoulder_lift, elbow_flex, wrist_flex: new servo, not calibrated yet"
    )
    assert jaw.startswith("gripper: the limits in the servo (0 to 4095) are wider")
    assert {type(new), type(jaw)} == {Doubt}, "so101 calibrate leaves them out"


@pytest.mark.parametrize("has_norm_mode", [True, False])
def test_where_the_published_module_s_zeros_differ_is_told_until_one_is_chosen(
    bench, tmp_path, has_norm_mode
):
    path = saved(tmp_path / "arm.json")
    content = json.loads(path.read_text())
    content["elbow_flex"]["range_max"] -= 160
    if not has_norm_mode:  # LeRobot's
        content = {
            joint: {name: value for name, value in entry.items() if name != "norm_mode"}
            for joint, entry in content.items()
        }
    path.write_text(json.dumps(content))
    hold_calibration(bench.world, store.read(path).calibration)
    before = bench.open(calibration_file=path)
    told, zeros = before.servos.notes, before.servos.encoder_zeros
    bench.shut(before)
    chosen = bench.open(calibration_file=path, joint_zero="homing").servos
    kept = shift(zeros, chosen.encoder_zeros, what="the pose", file=path)

    assert any("would add elbow_flex -7." in note for note in told) == has_norm_mode
    assert math.degrees(kept[2]) == pytest.approx(-7.0, abs=0.2)  # a kept pose is converted
    assert not any("joint_zero" in note for note in chosen.notes)
    elbow = chosen.setups["elbow_flex"]
    assert elbow.zero.by == "homing"
    assert elbow.map.zero_ticks == 2047
    assert elbow.map.lower + elbow.map.upper == pytest.approx(2 * elbow.zero.angle, abs=0.01)


def test_a_file_that_lies_where_the_published_module_put_it_is_pointed_out(
    bench, tmp_path, monkeypatch
):
    (tmp_path / "program").mkdir()
    monkeypatch.chdir(tmp_path / "program")
    lost = saved(tmp_path / "program" / "so101_calibration.json", servos=bench)
    rig = bench.open(calibration_file=tmp_path / "data" / "so101_calibration.json")

    assert any(f"A file of that name is {lost}" in note for note in rig.servos.notes)
    assert "file" not in {setup.source for setup in rig.servos.setups.values()}


@pytest.mark.emulated(calibrated=True)
async def test_the_arm_s_configuration_says_where_zero_is(models, tmp_path):
    offsets = dict(zip(ARM, MIDDLES_DEG, strict=True))
    path = saved(tmp_path / "arm.json", servos=models)
    arm = models.new_arm(calibration_file=str(path), joint_zero_offsets_deg=offsets)
    await models.pass_time(1.0)
    async with arm_client(arm) as client:
        told = await models.in_time(client.get_joint_positions())
    assert list(told.values) == pytest.approx(list(models.q_deg[:5]), abs=0.5)
