"""Compute what an identification found, from what it recorded; numbers in, numbers out.

It takes some seconds of a processor, so it is done in a process of its own. Nothing here knows of
an arm or a port; that keeps the start of that process short.
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
    """How far an emulated joint was from the real one, mean of its whole motion [rad].

    Attributes:
        as_sold: With the figures of the servo's type.
        as_known: With the figures that are kept, or were just found.
    """

    as_sold: float
    as_known: float


def figures(
    records: Mapping[str, JointRecord],
    *,
    hand_is_empty: bool,
    known: Mapping[str, ServoFigures],
    judges_found: bool,
) -> tuple[Identified, dict[str, Prediction]]:
    """What the records say of the servos, and how well figures predict what the joints did.

    Args:
        records: What each joint did, by name; those of all joints are needed to weigh a load.
        hand_is_empty: Whether it is known that the hand carries nothing.
        known: Figures of an earlier time with an empty hand; with something in it only a load is
            then looked for with an open mind.
        judges_found: Whether the predictions are of what was found; else of what was known.
    """
    found = identify(
        records,
        gravity_of,
        hand=None if hand_is_empty else place_in_hand(RobotModel.load()),
        known=None if hand_is_empty else known,  # an empty hand leaves no doubt, so look anew
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
