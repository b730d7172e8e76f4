"""What a calibration says about angles: which encoder position is the zero of each joint.

A servo subtracts its homing offset from its encoder, and a calibration says which of the resulting
ticks is the joint's zero. Only their sum matters: two calibrations with the same sums give the same
angles, however they were recorded. Limits alone change no angle.
"""

from __future__ import annotations

from collections.abc import Mapping

from so101_motion.calib.record.record import JOINTS, Calibration
from so101_motion.calib.record.zero import MIDDLE, Zero, zero_ticks
from so101_motion.common.encoder_zeros import EncoderZero
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.drivers.bus.registers import TICKS_PER_TURN


def encoder_zeros(calibration: Calibration, zeros: Mapping[str, Zero]) -> dict[str, EncoderZero]:
    """The zero of each joint of a calibration; without an entry in ``zeros`` it is the middle."""
    found = {}
    for joint in JOINTS:
        if joint not in calibration:
            continue
        entry = calibration[joint]
        if joint == GRIPPER_JOINT:
            at_zero: float = entry.range_max if entry.drive_mode else entry.range_min
        else:
            at_zero = zero_ticks(entry, zeros.get(joint, MIDDLE))
        found[joint] = EncoderZero(
            direction=-1 if entry.drive_mode else 1,
            ticks=round((at_zero + entry.homing_offset) % TICKS_PER_TURN, 1) % TICKS_PER_TURN,
        )
    return found
