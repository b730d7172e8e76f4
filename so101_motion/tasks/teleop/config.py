"""Read the attributes of ``devrel:so101:teleop``, and the command line's options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from so101_motion.common.attributes import (
    ACCELERATION_CAP,
    SPEED_CAP,
    Attribute,
    Attributes,
    Config,
    attribute,
    checked_number,
    derived,
)
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_rad
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.tasks.teleop.pilot import FULL_JERK, Mirror, Pace

RATE = 100.0
"""How often an arm of another module is read by default [1/s]; the published module's later
default. Arms of this process run at the rate of their bus."""

FACTOR_RANGE = (0.1, 3.0)  # range of the scale of the leader's motion, in either direction; chosen


def _required(given: Attributes, key: str) -> str:
    name: str | None = given.value(key)
    if name is None:
        raise ConfigError(key, None, "is missing; give the name of an arm of this machine")
    return name


def _mirror(given: Attributes, key: str) -> Mirror:
    offsets_deg = given.angles("offsets_deg", ARM_JOINTS)
    mirror = Mirror(
        factors=_factors(given.raw("scale")),
        offsets=to_rad(np.array([offsets_deg.get(joint, 0.0) for joint in ARM_JOINTS])),
    )
    return mirror.facing() if given.value("mirror") else mirror


def _pace(given: Attributes, key: str) -> Pace:
    speed, approach = (given.value(f"{each}speed_degs_per_sec") for each in ("", "approach_"))
    acceleration = given.value("acceleration_degs_per_sec_per_sec")
    gentle = min(acceleration, to_rad(100.0))
    return Pace(
        full=MotionLimits.uniform(velocity=speed, acceleration=acceleration, jerk=FULL_JERK),
        approach=MotionLimits.uniform(
            velocity=min(approach, speed), acceleration=gentle, jerk=gentle / 0.03
        ),
    )


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


@dataclass(frozen=True, slots=True, kw_only=True)
class TeleopConfig(Config):
    """Settings of ``devrel:so101:teleop``.

    By default the follower may use the largest caps there are, because a hand is fast; the arm's
    own caps are for planned motions.
    """

    leader_arm: str = attribute("leader_arm", kind="text", by=_required)
    follower_arm: str = attribute("follower_arm", kind="text", by=_required)
    leader_gripper: str | None = attribute("leader_gripper", kind="text")
    follower_gripper: str | None = attribute("follower_gripper", kind="text")
    rate: float = attribute(
        "rate_hz", unit="Hz", range=(0.0, 1000.0), default=RATE, zero_is_none=True
    )
    lets_go: bool = attribute("manage_leader_torque", kind="flag", default=True)
    auto_start: bool = attribute("auto_start", kind="flag", default=False)
    mirror: Mirror = derived(  # maps the leader's angles to the follower's
        _mirror,
        Attribute("scale", kind="own", ours=True),
        Attribute("offsets_deg", kind="own", ours=True),
        Attribute("mirror", kind="flag", default=False, ours=True),
    )
    pace: Pace = derived(  # the follower's caps
        _pace,
        SPEED_CAP,
        ACCELERATION_CAP,
        Attribute(
            "approach_speed_degs_per_sec", unit="deg/s", range=(1.0, 90.0), default=30.0, ours=True
        ),
    )
    guarded: bool = attribute("collision_guard", kind="flag", default=True, ours=True)
    asks_for_guard: bool = derived(lambda given, _: given.given("collision_guard"))

    CHECKED = (
        Attribute(
            "max_consecutive_errors",
            range=(0.0, 1e9),
            idle="the follower holds at once when the leader is lost",
        ),
    )

    def __post_init__(self) -> None:
        if self.leader_arm == self.follower_arm:
            raise ConfigError(
                "follower_arm", self.follower_arm, "is the leader already; give another arm"
            )

    @property
    def grippers(self) -> tuple[str, str] | None:
        """The leader's gripper and the follower's; None to leave both alone."""
        if self.leader_gripper and self.follower_gripper:
            return self.leader_gripper, self.follower_gripper
        return None

    @property
    def dependencies(self) -> tuple[str, ...]:
        """The names it needs, in the published module's order."""
        grippers = (self.leader_gripper, self.follower_gripper)
        return tuple(name for name in (self.leader_arm, self.follower_arm, *grippers) if name)


def read_how(attributes: Mapping[str, object]) -> tuple[Mirror, Pace]:
    """Read the scale, the offsets, ``mirror``, the speeds and the acceleration."""
    given = Attributes(attributes, TeleopConfig.rows())
    return _mirror(given, ""), _pace(given, "")
