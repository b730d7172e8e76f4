"""Explain the zeros in force to the user: where they come from, and what they change at the jaws.

Few people know what an angle that is four degrees off means; 40 mm at the jaws is clear. The
figures are the model's, over configurations in all of its range.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from so101_motion.calib.record.record import Calibration, JointCalibration
from so101_motion.calib.record.store import Stored
from so101_motion.calib.record.zero import STOPS, SWEPT, Zero, excess, in_force
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_mm
from so101_motion.planning.kinematics.model import RobotModel

_CONFIGURATIONS = 200

_STOPS_MIDDLE = {joint: sum(STOPS[joint]) / 2.0 for joint in SWEPT}


@dataclass(frozen=True, slots=True, kw_only=True)
class ZeroReport:
    """The explanation of one joint's zero, or of all together."""

    joint: str  # the joint; empty for all of them together
    by: str  # as in ``Zero``; for all of them, the sources in use
    angle_deg: float  # the model's angle at the middle of the recorded travel [deg]; 0 for all
    # how far at most the jaws are from where LeRobot, which takes that middle as zero, would report
    # them [mm]
    jaws_mm: float
    sentence: str  # all of it in one sentence


def explain(
    zeros: Mapping[str, Zero], calibration: Calibration, model: RobotModel
) -> tuple[ZeroReport, ...]:
    """Explain the zero of each joint, base to wrist; the last is about all together."""
    joints = [joint for joint in ARM_JOINTS if joint in zeros and joint in calibration]
    configurations = np.random.default_rng(0).uniform(
        model.lower, model.upper, (_CONFIGURATIONS, 5)
    )
    jaws = _Jaws(model, configurations)
    each = [_of_joint(joint, zeros[joint], calibration[joint], jaws) for joint in joints]
    return (*each, _of_all({joint: zeros[joint] for joint in joints}, jaws))


def explain_stored(stored: Stored) -> tuple[ZeroReport, ...]:
    zeros = {
        joint: in_force(stored.zeros.get(joint), None, stored.calibration[joint], None)
        for joint in ARM_JOINTS
        if joint in stored.calibration
    }
    return explain(zeros, stored.calibration, RobotModel.load()) if zeros else ()


class _Jaws:
    """Computes how far the jaws move when joint angles change."""

    def __init__(self, model: RobotModel, configurations: np.ndarray) -> None:
        self._model, self._configurations = model, configurations
        self._before = self._at(configurations)

    def moved_mm(self, angles: Mapping[str, float]) -> tuple[float, float]:
        """The mean and the most, when ``angles`` [rad] are added to the joints'."""
        added = np.array([angles.get(joint, 0.0) for joint in ARM_JOINTS])
        distances = np.linalg.norm(self._at(self._configurations + added) - self._before, axis=1)
        return to_mm(float(distances.mean())), to_mm(float(distances.max()))

    def _at(self, configurations: np.ndarray) -> np.ndarray:
        return np.array([self._model.frame(q, "jaw_tip").p for q in configurations])


def _of_joint(joint: str, zero: Zero, entry: JointCalibration, jaws: _Jaws) -> ZeroReport:
    _, most = jaws.moved_mm({joint: zero.angle})
    angle_deg = to_deg(zero.angle)
    if zero.by == "middle":
        sentence = "zero is the middle of its travel, as for LeRobot"
        if joint in SWEPT:
            off = _STOPS_MIDDLE[joint]
            sentence += (
                f"; between its stops the middle is at {to_deg(off):+.1f} deg of the model, up to"
                f" {jaws.moved_mm({joint: off})[1]:.0f} mm at the jaws"
            )
    else:
        sentence = (
            f"zero is known {_source(joint, zero, entry)}; LeRobot's, the middle of the travel, is"
            f" at {angle_deg:+.1f} deg, up to {most:.0f} mm at the jaws"
        )
    return ZeroReport(
        joint=joint,
        by=zero.by,
        angle_deg=angle_deg,
        jaws_mm=most,
        sentence=f"{joint}: {sentence}",
    )


def _source(joint: str, zero: Zero, entry: JointCalibration) -> str:
    if zero.by == "stops":
        more_deg = to_deg(excess(joint, entry))
        word = "longer" if more_deg > 0.0 else "shorter"
        return f"by its stops (the travel is {abs(more_deg):.1f} deg {word} than between them)"
    return {
        "pose": "from the pose it was held in",
        "homing": "from the pose of set_homing",
        "configured": "from joint_zero_offsets_deg",
    }[zero.by]


def _of_all(zeros: Mapping[str, Zero], jaws: _Jaws) -> ZeroReport:
    mean, most = jaws.moved_mm({joint: zero.angle for joint, zero in zeros.items()})
    if all(zero.by == "middle" for zero in zeros.values()):
        off, _ = jaws.moved_mm(_STOPS_MIDDLE)
        sentence = (
            "each joint's zero is the middle of its travel, which puts the jaws about"
            f" {off:.0f} mm off if the travels go from stop to stop"
        )
    else:
        sentence = (
            f"the zeros in use differ from LeRobot's by {mean:.0f} mm at the jaws on average, at"
            f" most {most:.0f} mm"
        )
    sources = ", ".join(sorted({zero.by for zero in zeros.values()}))
    return ZeroReport(joint="", by=sources, angle_deg=0.0, jaws_mm=most, sentence=sentence)
