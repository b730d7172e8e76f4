"""The models that this module and the published one share: what each takes, and how it differs.

A table for ``migration.py``: the attributes of both, those of ours alone and what holds without
them, those without effect, and what behaves differently, a line each with its reason.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from so101_motion.config import (
    Attributes,
    LoadConfig,
    SimulatedArmConfig,
    SimulatedGripperConfig,
)
from so101_motion.discovery import ports_asked_for
from so101_motion.errors import ConfigError
from so101_motion.hardware_config import (
    CalibrationConfig,
    HardwareArmConfig,
    HardwareGripperConfig,
    duration,
)
from so101_motion.teleop.config import TeleopConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """A model of both modules: what it takes here, and how it differs.

    Attributes:
        read: Checks attributes; raises ``ConfigError``.
        shared: The attributes both know.
        new: Those that only this module knows, and what holds without them.
        idle: Those that are understood and have no effect, and why.
        meanings: What a value means here, where that needs words.
        differences: What behaves differently, given the attributes.
    """

    read: Callable[[Mapping[str, Any]], object]
    shared: tuple[str, ...]
    new: Mapping[str, str]
    idle: Mapping[str, str]
    meanings: Mapping[str, Callable[[Any], str]]
    differences: Callable[[Mapping[str, Any]], tuple[str, ...]]

    @property
    def names(self) -> tuple[str, ...]:
        """All attributes it takes."""
        return (*self.shared, *self.new)


def _seconds(value: Any) -> str:
    try:
        return f"{duration('timeout', value):g} s, for servos to answer at the start"
    except ConfigError:
        return "a duration"


def _planned_by(value: Any) -> str:
    if value in (None, "", "builtin"):
        return "planned by this module"
    return f"planned by the service {value}"


_PORT = ("port", "calibration_file", "baudrate", "timeout")
_MEANINGS: Mapping[str, Callable[[Any], str]] = {
    "timeout": _seconds,
    "motion": _planned_by,
    "calibration_file": lambda _: "the same file; see below",
}
_SURROUNDINGS = {
    "floor_z_mm": "-2.4: moves that would touch the table are refused",
    "obstacles": "nothing stands around the arm",
    **dict(zip(LoadConfig.KEYS, ("nothing is carried", "the jaw's tip", "7.4"), strict=True)),
}
_ARM_LOOKS = ("visualize_ee_frame", "use_urdf", "mesh_decimation_ratios", "motion")
_TOLERANCES = ("orientation_tolerance_deg", "position_tolerance_mm")
_MESHES = {"mesh_decimation_ratios": "the meshes here are light as they are"}


def _arm_differences(given: Mapping[str, Any]) -> tuple[str, ...]:
    lines = [
        "waypoints are followed; there only the last one of a path was gone to",
        "stop, a cancelled call and a lost client bring the arm to rest at once, for they mean it",
        "acceleration is enforced, jerk too, and joints arrive together: a plan is a timed one",
        "a newer move ends the older one (ABORTED); there it waited",
        "targets outside the calibrated range are refused with the limit; there they were clamped",
    ]
    if "acceleration_degs_per_sec_per_sec" not in given:
        lines.append(
            "acceleration is 100 deg/s2 when it is not given, as first published; later versions"
            ' take 500: set "acceleration_degs_per_sec_per_sec" to keep that'
        )
    if given.get("motion") in (None, "", "builtin"):
        lines.append(
            "MoveToPosition is planned here, point only, for five joints cannot take every"
            " orientation; extra.goal_metric_type asks for more"
        )
    return tuple(lines)


def _gripper_differences(given: Mapping[str, Any]) -> tuple[str, ...]:
    lines = [
        "grab says whether the jaw was stopped by something, and holds it gently",
        "closing by set_position grips what it meets instead of crushing it",
    ]
    if given.get("port") and given.get("arm"):
        lines.append("the arm's port is used, for one port has one owner")
    return tuple(lines)


def _for_an_arm(given: Mapping[str, Any]) -> object:
    return Attributes(given, ("arm",)).text("arm", "")


KNOWN: Mapping[str, Model] = {
    "arm": Model(
        read=HardwareArmConfig.from_attributes,
        shared=(*_PORT, "servo_ids", "speed_degs_per_sec", "acceleration_degs_per_sec_per_sec",
                *_ARM_LOOKS, *_TOLERANCES, "manual_mode"),
        new={
            "joint_zero_offsets_deg": "zeros as the calibration says",
            "control_rate_hz": "100",
            "at_end": "hold",
            **_SURROUNDINGS,
        },
        idle=_MESHES,
        meanings=_MEANINGS,
        differences=_arm_differences,
    ),
    "gripper": Model(
        read=HardwareGripperConfig.from_attributes,
        shared=(*_PORT, "arm", "servo_id", "gripper_type", "mesh_detail"),
        new={"control_rate_hz": "100"},
        idle={},
        meanings=_MEANINGS,
        differences=_gripper_differences,
    ),
    "simulated": Model(
        read=SimulatedArmConfig.from_attributes,
        shared=("speed_degs_per_sec", "simulate_time", *_ARM_LOOKS, *_TOLERANCES),
        new={"acceleration_degs_per_sec_per_sec": "100", **_SURROUNDINGS},
        idle=_MESHES,
        meanings=_MEANINGS,
        differences=lambda _: (
            "it is planned for and moved as the real arm is, within its accelerations; there it"
            " turned at constant speed",
            "speeds are 3 to 180 deg/s, as for the real one",
        ),
    ),
    "simulated-gripper": Model(
        read=SimulatedGripperConfig.from_attributes,
        shared=("gripper_type", "mesh_detail"),
        new={},
        idle={},
        meanings={},
        differences=lambda _: (),
    ),
    "calibration": Model(
        read=CalibrationConfig.from_attributes,
        shared=(*_PORT, "servo_ids"),
        new={"control_rate_hz": "100"},
        idle={"timeout": "a calibration waits for servos as long as it takes"},
        meanings=_MEANINGS,
        differences=lambda _: (
            "saving merges with what the file says, keeps versions, and writes where the next start"
            " reads",
            "a joint may cross the end of its servo's counter while it is recorded",
        ),
    ),
    "motion": Model(
        read=_for_an_arm,
        shared=("arm",),
        new={},
        idle={},
        meanings={},
        differences=lambda _: ("only this module has it",),
    ),
    "world-state": Model(
        read=_for_an_arm,
        shared=("arm",),
        new={},
        idle={},
        meanings={},
        differences=lambda _: ("only this module has it",),
    ),
    "discovery": Model(
        read=ports_asked_for,
        shared=(),
        new={"ports": "only what is found"},
        idle={},
        meanings={},
        differences=lambda _: (),
    ),
    "teleop": Model(
        read=TeleopConfig.from_attributes,
        shared=("leader_arm", "follower_arm", "leader_gripper", "follower_gripper", "rate_hz",
                "manage_leader_torque", "auto_start", "max_consecutive_errors"),
        new={
            "scale": "1",
            "mirror": "false",
            "offsets_deg": "0",
            "speed_degs_per_sec": "180",
            "acceleration_degs_per_sec_per_sec": "500",
            "approach_speed_degs_per_sec": "30",
            "collision_guard": "false",
        },
        idle={"max_consecutive_errors": "who is lost is held for at once, not after some errors"},
        meanings={},
        differences=lambda _: (
            "the follower comes to the leader slowly before it follows; there it jumped",
            "a lost leader or follower means hold; there it went on",
        ),
    ),
}  # fmt: skip

OURS = {key for known in KNOWN.values() for key in known.new} - {
    "speed_degs_per_sec", "acceleration_degs_per_sec_per_sec",
}  # fmt: skip
"""The attributes that the published module does not know at all."""
