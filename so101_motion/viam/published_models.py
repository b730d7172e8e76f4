"""Every model of this module, and how it differs from that of the published module.

The attributes are in ``component_config``; this file has the meaning of their values and a line for
each difference in behaviour, with its reason. ``migration`` uses it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from so101_motion.common.attributes import Config
from so101_motion.common.errors import ConfigError
from so101_motion.tasks.teleop.config import TeleopConfig
from so101_motion.viam.component_config import (
    CalibrationConfig,
    DiscoveryConfig,
    ForAnArmConfig,
    HardwareArmConfig,
    HardwareGripperConfig,
    MotionConfig,
    SimulatedArmConfig,
    SimulatedGripperConfig,
    duration,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """A model: its attributes, and the differences from the published module.

    Attributes:
        config: The attributes it takes.
        differences: The differences in behaviour for given attributes, a line each.
    """

    config: type[Config]
    differences: Callable[[Mapping[str, Any]], tuple[str, ...]] = lambda _: ()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all attributes it takes."""
        return tuple(each.name for each in self.config.rows())


def _seconds(value: Any) -> str:
    try:
        return f"{duration('timeout', value):g} s, for servos to answer at the start"
    except ConfigError:
        return "a duration"


def _planned_by(value: Any) -> str:
    if value in (None, ""):
        return "planned by this module"
    return f"planned by the service {value}; leave it out to use this module's planner"


def _only_here(_: Mapping[str, Any]) -> tuple[str, ...]:
    return ("only this module has it",)


MEANINGS: Mapping[str, Callable[[Any], str]] = {
    "timeout": _seconds,
    "motion": _planned_by,
    "calibration_file": lambda _: "the same file; see below",
}
"""The meaning of an attribute's value in this module, where it needs an explanation."""


def _arm_differences(given: Mapping[str, Any]) -> tuple[str, ...]:
    lines = [
        "the arm follows all waypoints; the published module went only to the last one",
        "a stop, a cancelled call or a lost client brings the arm to rest at once",
        "acceleration and jerk are limited too, and all joints arrive together",
        "a newer move ends the older one (ABORTED); in the published module it waited",
        "targets outside the calibrated range are refused; the published module clamped them",
    ]
    if "acceleration_degs_per_sec_per_sec" not in given:
        lines.append(
            "acceleration is 100 deg/s2 when it is not given, as first published; later versions"
            ' take 500: set "acceleration_degs_per_sec_per_sec" to keep that'
        )
    if given.get("motion") in (None, ""):
        lines.append(
            "this module plans MoveToPosition for the position only, because five joints cannot"
            " reach every orientation; set extra.goal_metric_type for more"
        )
    return tuple(lines)


def _gripper_differences(given: Mapping[str, Any]) -> tuple[str, ...]:
    lines = [
        "grab returns whether an object stopped the jaw, and holds the object gently",
        "closing with set_position grips an object in the way instead of crushing it",
    ]
    if given.get("port") and given.get("arm"):
        lines.append("the arm's port is used, because a port has one owner")
    return tuple(lines)


MODELS: Mapping[str, Model] = {
    "arm": Model(
        config=HardwareArmConfig,
        differences=_arm_differences,
    ),
    "gripper": Model(
        config=HardwareGripperConfig,
        differences=_gripper_differences,
    ),
    "simulated": Model(
        config=SimulatedArmConfig,
        differences=lambda _: (
            "it plans and moves like the real arm, with limited acceleration; in the published"
            " module it turned at constant speed",
            "a speed outside 3 to 180 deg/s, as the real arm has them, becomes the nearest",
        ),
    ),
    "simulated-gripper": Model(config=SimulatedGripperConfig),
    "calibration": Model(
        config=CalibrationConfig,
        differences=lambda _: (
            "saving keeps the file's other joints and its older versions, and writes the file that"
            " the next start reads",
            "a joint may cross the end of its servo's counter while it is recorded",
        ),
    ),
    "motion": Model(config=MotionConfig, differences=_only_here),
    "world-state": Model(config=ForAnArmConfig, differences=_only_here),
    "discovery": Model(config=DiscoveryConfig),
    "teleop": Model(
        config=TeleopConfig,
        differences=lambda _: (
            "the follower moves slowly to the leader's position before it follows; in the published"
            " module it jumped",
            "when leader or follower is lost, the follower holds; in the published module it went"
            " on",
        ),
    ),
}
"""The models by their name without ``devrel:so101:``."""

_ALL = [each for model in MODELS.values() for each in model.config.rows()]
OURS = {each.name for each in _ALL if each.ours} - {each.name for each in _ALL if not each.ours}
"""The attributes that no model of the published module has."""
