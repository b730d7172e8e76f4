"""Compute the figures of an identification from its records; numbers in, numbers out.

It takes about half a minute of a processor, so it runs in a separate process. It imports neither
arm nor port, which keeps the start of that process short.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from so101_motion.calib.procedure.servo_fit import Gravity, Identified, identify, weights_of
from so101_motion.calib.procedure.servo_twin import JointRecord, predicted
from so101_motion.common.geometry import Array
from so101_motion.drivers.bus.ticks import RAD_PER_TICK
from so101_motion.drivers.servo_types import AS_SOLD, ServoFigures
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.torque import place_in_hand


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """How far an emulated joint was from the real one, mean of its whole motion [rad]."""

    as_sold: float  # with the figures of the servo's type
    as_known: float  # with the saved figures, or those just found


def figures(
    records: Mapping[str, JointRecord],
    *,
    hand_is_empty: bool,
    known: Mapping[str, ServoFigures],
    judges_found: bool,
) -> tuple[Identified, dict[str, Prediction]]:
    """Identify the servos from records, and test how well the figures predict the joints' motion.

    Args:
        records: The record of each joint, by name; a load's mass needs those of all joints.
        hand_is_empty: Whether the hand is known to be empty.
        known: Earlier figures, from an empty hand; with a load in the hand they stay nearly fixed,
            and only the load is identified freely.
        judges_found: Whether the predictions use the new figures; else the known ones.
    """
    found = identify(
        records,
        gravity_of,
        hand=None if hand_is_empty else place_in_hand(RobotModel.load()),
        known=None if hand_is_empty else known,  # with an empty hand the servos are identified anew
    )
    weights = weights_of(records, gravity_of, found.load)
    servos = found.servos if judges_found else known

    def off(joint: str, figures: ServoFigures) -> float:
        record = records[joint]
        ticks = predicted(record, figures, weights[joint])
        return float(np.mean(np.abs(ticks - record.ticks))) * RAD_PER_TICK

    return found, {
        joint: Prediction(
            as_sold=off(joint, AS_SOLD), as_known=off(joint, servos.get(joint, AS_SOLD))
        )
        for joint in records
    }


def gravity_of(mass: float, place: Array) -> Gravity:
    """The holding torques of the arm with ``mass`` [kg] at ``place`` in the tool frame [m]."""
    model = RobotModel.load()
    return (model.with_payload(mass, place) if mass else model).holding_torques
