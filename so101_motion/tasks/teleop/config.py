"""Read the attributes of ``devrel:so101:teleop``, and the command line's options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from so101_motion.common.attributes import (
    ACCELERATION_RANGE_DEG,
    SPEED_RANGE_DEG,
    Attribute,
    Attributes,
    checked_number,
)
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_rad
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.tasks.teleop.mirror import Mirror
from so101_motion.tasks.teleop.pilot import FULL_JERK, Pace

RATE = 100.0
"""How often an arm of another module is read by default [1/s]; the published module's later
default. Arms of this process run at the rate of their bus."""

FACTOR_RANGE = (0.1, 3.0)
"""Range of the scale of the leader's motion, in either direction; chosen."""

ATTRIBUTES = (
    Attribute("leader_arm", "the arm that leads", kind="text", form="name", otherwise="required"),
    Attribute(
        "follower_arm", "the arm that follows, another one", kind="text", form="name",
        otherwise="required",
    ),
    Attribute(
        "leader_gripper", "the leader's gripper; the jaw follows only if both grippers are named",
        kind="text", form="name",
    ),
    Attribute("follower_gripper", "the follower's gripper", kind="text", form="name"),
    Attribute(
        "rate_hz", "how often an arm of another module is read; ours run at the rate of their bus",
        unit="Hz", range=(0.0, 1000.0), default=RATE, zero_is_none=True,
    ),
    Attribute(
        "manage_leader_torque",
        "whether the leader is released when it starts, and held again when it ends",
        kind="flag", default=True,
    ),
    Attribute(
        "auto_start", "whether it starts by itself with the module", kind="flag", default=False
    ),
    Attribute(
        "scale", "factor of the leader's motion; a negative one reverses the joint",
        kind="own", form="0.1 to 3, a number or five", otherwise="1", ours=True,
    ),
    Attribute(
        "offsets_deg", "added to the follower's angles", kind="own",
        form="deg, -180 to 180, by joint or five", otherwise="0", ours=True,
    ),
    Attribute(
        "mirror", "for arms that face each other: pan and roll turn the other way", kind="flag",
        default=False, ours=True,
    ),
    Attribute(
        "speed_degs_per_sec", "cap while mirroring", unit="deg/s", range=SPEED_RANGE_DEG,
        default=SPEED_RANGE_DEG[1], ours=True,
    ),
    Attribute(
        "acceleration_degs_per_sec_per_sec", "cap while mirroring; with the guard 380 at most",
        unit="deg/s^2", range=ACCELERATION_RANGE_DEG, default=ACCELERATION_RANGE_DEG[1], ours=True,
    ),
    Attribute(
        "approach_speed_degs_per_sec", "cap while coming closer", unit="deg/s",
        range=(1.0, 90.0), default=30.0, ours=True,
    ),
    Attribute(
        "collision_guard", "whether the follower keeps clear of itself and what is around",
        kind="flag", default=True, ours=True,
    ),
    Attribute(
        "max_consecutive_errors", "checked, without effect", range=(0.0, 1e9), default=0.0,
        otherwise="none", idle="the follower holds at once when the leader is lost",
    ),
)  # fmt: skip
"""The attributes of ``devrel:so101:teleop``. By default the follower may use the largest caps there
are, because a hand is fast; the arm's own caps are for planned motions."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TeleopConfig:
    """Settings of ``devrel:so101:teleop``."""

    leader_arm: str
    follower_arm: str
    grippers: tuple[str, str] | None  # the leader's and the follower's; None to leave both alone
    rate: float  # how often an arm of another module is read [1/s]
    lets_go: bool  # whether the leader is released while it leads
    auto_start: bool
    mirror: Mirror  # maps the leader's angles to the follower's
    pace: Pace  # the follower's caps
    guarded: bool  # whether the follower keeps clear of itself and its surroundings
    asks_for_guard: bool  # whether that was given, and is not just the default
    dependencies: tuple[str, ...]  # the names it needs, in the published module's order

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, object]) -> TeleopConfig:
        """Read and check the attributes; raises ``ConfigError`` for what cannot be used."""
        given = Attributes(attributes, ATTRIBUTES)
        leader, follower = (_required(given, f"{side}_arm") for side in ("leader", "follower"))
        if leader == follower:
            raise ConfigError("follower_arm", follower, "is the leader already; give another arm")
        grippers = (given.value("leader_gripper"), given.value("follower_gripper"))
        given.value("max_consecutive_errors")  # only checked
        return cls(
            leader_arm=leader,
            follower_arm=follower,
            grippers=grippers if all(grippers) else None,
            rate=given.value("rate_hz"),
            lets_go=given.value("manage_leader_torque"),
            auto_start=given.value("auto_start"),
            mirror=read_mirror(attributes),
            pace=read_pace(attributes),
            guarded=given.value("collision_guard"),
            asks_for_guard=given.given("collision_guard"),
            dependencies=tuple(name for name in (leader, follower, *grippers) if name),
        )


def read_mirror(attributes: Mapping[str, object]) -> Mirror:
    """Read ``scale``, ``offsets_deg`` and ``mirror``.

    Raises:
        ConfigError: One of them cannot be used.
    """
    given = Attributes(attributes, ATTRIBUTES)
    offsets_deg = given.angles("offsets_deg", ARM_JOINTS)
    mirror = Mirror(
        factors=_factors(attributes.get("scale")),
        offsets=to_rad(np.array([offsets_deg.get(joint, 0.0) for joint in ARM_JOINTS])),
    )
    return mirror.facing() if given.value("mirror") else mirror


def read_pace(attributes: Mapping[str, object]) -> Pace:
    """Read the speeds and the acceleration.

    Raises:
        ConfigError: One of them cannot be used.
    """
    given = Attributes(attributes, ATTRIBUTES)
    speed, approach = (given.value(f"{each}speed_degs_per_sec") for each in ("", "approach_"))
    acceleration = given.value("acceleration_degs_per_sec_per_sec")
    gentle = min(acceleration, to_rad(100.0))
    return Pace(
        full=MotionLimits.uniform(velocity=speed, acceleration=acceleration, jerk=FULL_JERK),
        approach=MotionLimits.uniform(
            velocity=min(approach, speed), acceleration=gentle, jerk=gentle / 0.03
        ),
    )


def _required(given: Attributes, key: str) -> str:
    name: str | None = given.value(key)
    if name is None:
        raise ConfigError(key, None, "is missing; give the name of an arm of this machine")
    return name


def _factors(value: object) -> Array:
    if value in (None, ""):
        return np.ones(5)
    values = value if isinstance(value, (list, tuple)) else [value] * 5
    if len(values) != len(ARM_JOINTS):
        raise ConfigError("scale", value, f"must be a number, or {len(ARM_JOINTS)} of them")
    factors = [checked_number(f"scale[{i}]", entry) for i, entry in enumerate(values)]
    lower, upper = FACTOR_RANGE
    if any(not lower <= abs(factor) <= upper for factor in factors):
        raise ConfigError(
            "scale", value, f"must be {lower:g} to {upper:g}, or minus that to turn the other way"
        )
    return np.array(factors)
