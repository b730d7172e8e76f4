"""The attributes of ``devrel:so101:teleop``, and what the command line's options mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from so101_motion.config import ACCELERATION_RANGE_DEG, SPEED_RANGE_DEG, Attributes, checked_number
from so101_motion.errors import ConfigError
from so101_motion.geometry import Array
from so101_motion.planning.limits import MotionLimits
from so101_motion.state import ARM_JOINTS
from so101_motion.teleop.mirror import Mirror
from so101_motion.teleop.pilot import FULL_JERK, Pace
from so101_motion.units import to_rad

RATE = 100.0
"""How often an arm elsewhere is asked unless somebody says otherwise [1/s]; the published module's
later default. Arms of this process go at the rate of their bus."""

SPEED_DEG, ACCELERATION_DEG = SPEED_RANGE_DEG[1], ACCELERATION_RANGE_DEG[1]
"""How fast the follower goes unless somebody says otherwise [deg/s], [deg/s^2]: as fast as motions
may be at all, for a hand is fast. The arm's own settings are for motions that are planned."""

APPROACH_DEG, APPROACH_RANGE_DEG = 30.0, (1.0, 90.0)
"""How fast the follower comes to the leader, and how fast it may [deg/s]; chosen."""

FACTOR_RANGE = (0.1, 3.0)
"""By how much the leader's motion may be scaled, either way round; chosen."""

_KNOWN = (
    "leader_arm", "follower_arm", "leader_gripper", "follower_gripper", "rate_hz",
    "manage_leader_torque", "auto_start", "max_consecutive_errors", "scale", "mirror",
    "offsets_deg", "speed_degs_per_sec", "acceleration_degs_per_sec_per_sec",
    "approach_speed_degs_per_sec", "collision_guard",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class TeleopConfig:
    """Settings of ``devrel:so101:teleop``.

    Attributes:
        leader_arm: Name of the arm that leads.
        follower_arm: Name of the arm that follows.
        grippers: Names of the leader's and the follower's gripper; None to leave them alone.
        rate: How often an arm elsewhere is asked [1/s].
        lets_go: Whether the leader is let go of while it leads.
        auto_start: Whether it starts by itself.
        mirror: Which angles of the follower belong to those of the leader.
        pace: How fast the follower goes.
        guarded: Whether the follower keeps clear of itself and its surroundings.
        dependencies: The names it needs, in the published module's order.
    """

    leader_arm: str
    follower_arm: str
    grippers: tuple[str, str] | None
    rate: float
    lets_go: bool
    auto_start: bool
    mirror: Mirror
    pace: Pace
    guarded: bool
    dependencies: tuple[str, ...]

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, object]) -> TeleopConfig:
        """Read and check the attributes of a service configuration.

        Raises:
            ConfigError: A name is unknown or a value cannot be used.
        """
        given = Attributes(attributes, _KNOWN)
        leader, follower = (_required(given, f"{side}_arm") for side in ("leader", "follower"))
        if leader == follower:
            raise ConfigError("follower_arm", follower, "leads already; give another arm")
        grippers = (given.text("leader_gripper", ""), given.text("follower_gripper", ""))
        # Only checked: whoever is lost makes the follower hold at once, not after some errors.
        given.number("max_consecutive_errors", 0.0, lower=0.0, upper=1e9)
        return cls(
            leader_arm=leader,
            follower_arm=follower,
            grippers=grippers if all(grippers) else None,
            rate=given.number("rate_hz", 0.0, lower=0.0, upper=1000.0, unit="Hz") or RATE,
            lets_go=given.flag("manage_leader_torque", True),
            auto_start=given.flag("auto_start", False),
            mirror=read_mirror(attributes),
            pace=read_pace(attributes),
            guarded=given.flag("collision_guard", False),
            dependencies=tuple(name for name in (leader, follower, *grippers) if name),
        )


def read_mirror(attributes: Mapping[str, object]) -> Mirror:
    """What ``scale``, ``offsets_deg`` and ``mirror`` say.

    Raises:
        ConfigError: One of them cannot be used.
    """
    given = Attributes(attributes, attributes)
    mirror = Mirror(
        factors=_factors(attributes.get("scale")),
        offsets=to_rad(_offsets_deg(attributes.get("offsets_deg"))),
    )
    return mirror.facing() if given.flag("mirror", False) else mirror


def read_pace(attributes: Mapping[str, object]) -> Pace:
    """What the speeds and the acceleration say.

    Raises:
        ConfigError: One of them cannot be used.
    """
    given = Attributes(attributes, attributes)

    def number(key: str, default: float, bounds: tuple[float, float], unit: str) -> float:
        return to_rad(given.number(key, default, lower=bounds[0], upper=bounds[1], unit=unit))

    speed = number("speed_degs_per_sec", SPEED_DEG, SPEED_RANGE_DEG, "deg/s")
    acceleration = number(
        "acceleration_degs_per_sec_per_sec", ACCELERATION_DEG, ACCELERATION_RANGE_DEG, "deg/s^2"
    )
    approach = number("approach_speed_degs_per_sec", APPROACH_DEG, APPROACH_RANGE_DEG, "deg/s")
    gentle = min(acceleration, to_rad(100.0))
    return Pace(
        full=MotionLimits.uniform(velocity=speed, acceleration=acceleration, jerk=FULL_JERK),
        approach=MotionLimits.uniform(
            velocity=min(approach, speed), acceleration=gentle, jerk=gentle / 0.03
        ),
    )


def _required(given: Attributes, key: str) -> str:
    name = given.text(key, "")
    if not name:
        raise ConfigError(key, None, "is missing; the name of an arm of this machine")
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


def _offsets_deg(value: object) -> Array:
    if value in (None, ""):
        return np.zeros(5)
    if isinstance(value, Mapping):
        given = Attributes(value, ARM_JOINTS, kind="joint")
        entries = [
            given.number(joint, 0.0, lower=-180.0, upper=180.0, unit="deg") for joint in ARM_JOINTS
        ]
        return np.array(entries)
    if not isinstance(value, (list, tuple)) or len(value) != len(ARM_JOINTS):
        raise ConfigError(
            "offsets_deg", value, f"must be {len(ARM_JOINTS)} numbers, or an object by joint"
        )
    return np.array(
        [
            checked_number(f"offsets_deg[{i}]", entry, lower=-180.0, upper=180.0, unit="deg")
            for i, entry in enumerate(value)
        ]
    )
