from __future__ import annotations

from dataclasses import replace

import pytest

from so101_motion.calib.record.record import JointCalibration
from so101_motion.calib.record.zero import Zero, encoder_zeros
from so101_motion.common.encoder_zeros import EncoderZero
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT

ENTRY = JointCalibration(id=1, homing_offset=100, range_min=1000, range_max=3000)


@pytest.mark.parametrize(
    ("entry", "zero", "ticks"),
    [
        (ENTRY, None, 2100.0),
        (replace(ENTRY, range_min=900, range_max=3100), None, 2100.0),  # limits alone: no angle
        (replace(ENTRY, homing_offset=600, range_min=500, range_max=2500), None, 2100.0),
        (replace(ENTRY, homing_offset=-2047, range_min=500, range_max=1500), None, 3049.0),
        (ENTRY, Zero(by="stops", angle=0.1), 2100.0 - 65.2),
    ],
)
def test_zero_on_the_encoder_is_that_of_ticks_and_offset_together(entry, zero, ticks) -> None:
    joint = ARM_JOINTS[0]
    found = encoder_zeros({joint: entry}, {} if zero is None else {joint: zero})
    assert found == {joint: EncoderZero(direction=1, ticks=pytest.approx(ticks))}


def test_a_jaw_is_at_zero_where_it_is_closed() -> None:
    turned = replace(ENTRY, drive_mode=1)
    assert encoder_zeros({GRIPPER_JOINT: ENTRY}, {})[GRIPPER_JOINT].ticks == 1100.0
    assert encoder_zeros({GRIPPER_JOINT: turned}, {})[GRIPPER_JOINT] == EncoderZero(
        direction=-1, ticks=3100.0
    )
