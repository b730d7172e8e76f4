"""Convert between Viam's units and ours, and from our errors to gRPC statuses.

A null in a struct reads back as 0 and a NaN as text, so neither is ever sent. A limit that nobody
set arrives as zero, so zero counts as not set.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from grpclib import GRPCError, Status
from grpclib.metadata import encode_grpc_message
from viam.proto.common import Pose
from viam.proto.component.arm import JointPositions, MoveOptions

from so101_motion.common import errors
from so101_motion.common.attributes import (
    ACCELERATION_RANGE_DEG,
    SPEED_RANGE_DEG,
    checked_number,
    suggest,
)
from so101_motion.common.errors import ConfigError, So101Error, clipped
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_m, to_mm, to_rad
from so101_motion.planning.goals import GoalMetric
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.viam.conversion.orientation import OrientationVector, from_rotation, to_rotation

# Poses and joints


def to_pose(T: SE3) -> Pose:
    """A transform as Viam's pose: millimetres, orientation vector, degrees."""
    vector = from_rotation(T.R)
    x, y, z = (float(to_mm(value)) for value in T.p)
    o_x, o_y, o_z = vector.o
    return Pose(x=x, y=y, z=z, o_x=o_x, o_y=o_y, o_z=o_z, theta=to_deg(vector.theta))


def from_pose(pose: Pose) -> SE3:
    values = {key: getattr(pose, key) for key in ("x", "y", "z", "o_x", "o_y", "o_z", "theta")}
    units = {"x": "mm", "y": "mm", "z": "mm", "theta": "deg"}
    for key, value in values.items():
        checked_number(f"pose.{key}", value, unit=units.get(key, ""))
    vector = OrientationVector(o=(pose.o_x, pose.o_y, pose.o_z), theta=to_rad(pose.theta))
    return SE3(to_rotation(vector), to_m(np.array([pose.x, pose.y, pose.z])))


def to_joint_positions(q: Array) -> JointPositions:
    """Joint angles in Viam's degrees."""
    return JointPositions(values=[float(value) for value in to_deg(q)])


def from_joint_values(values: Sequence[float], *, what: str = "positions") -> Array:
    """Joint angles, shape (5,), [rad], from Viam's degrees."""
    if len(values) != len(ARM_JOINTS):
        raise ConfigError(
            what,
            list(values),
            f"got {len(values)} joint values, but the arm has {len(ARM_JOINTS)} joints: "
            + ", ".join(ARM_JOINTS),
        )
    for joint, value in zip(ARM_JOINTS, values, strict=True):
        checked_number(f"{what}.{joint}", value, unit="deg")
    return to_rad(np.array(values, dtype=np.float64))


# Caps


def from_move_options(options: MoveOptions | None, base: MotionLimits) -> MotionLimits:
    """Read the caps of one move.

    A cap that is given replaces the arm's own for this move; the per-joint lists win over the
    single numbers. Zero counts as not given, because viam-server sends limits that nobody set as
    zeros. What exceeds the range of ``set_speed`` and ``set_acceleration`` is lowered to it.
    """
    if options is None:
        return base
    velocity = _caps(
        base.velocity,
        ("max_vel_degs_per_sec", options.max_vel_degs_per_sec),
        ("max_vel_degs_per_sec_joints", options.max_vel_degs_per_sec_joints),
        SPEED_RANGE_DEG[1],
    )
    acceleration = _caps(
        base.acceleration,
        ("max_acc_degs_per_sec2", options.max_acc_degs_per_sec2),
        ("max_acc_degs_per_sec2_joints", options.max_acc_degs_per_sec2_joints),
        ACCELERATION_RANGE_DEG[1],
    )
    tool_speed = checked_number("max_tcp_speed", options.max_tcp_speed, lower=0.0, unit="m/s")
    if 0.0 < tool_speed < _SLOWEST_TOOL:
        raise ConfigError("max_tcp_speed", tool_speed, f"must be at least {_SLOWEST_TOOL} m/s")
    return MotionLimits(
        velocity=velocity,
        acceleration=acceleration,
        jerk=base.jerk * acceleration / base.acceleration,  # the same time to build it up
        tool_speed=tool_speed if tool_speed > 0.0 else base.tool_speed,
    )


def to_move_options(velocity: Array, acceleration: Array) -> MoveOptions:
    """Write the caps of each joint, [rad/s] and [rad/s^2], into a request."""
    return MoveOptions(
        max_vel_degs_per_sec_joints=to_deg(velocity).tolist(),
        max_acc_degs_per_sec2_joints=to_deg(acceleration).tolist(),
    )


_SLOWEST_DEG = 0.1  # [deg/s] and [deg/s^2]; chosen: a full sweep then takes an hour
_SLOWEST_TOOL = 1e-4  # [m/s]; chosen for the same reason


def _caps(
    base: Array,
    scalar: tuple[str, float],
    per_joint: tuple[str, Sequence[float]],
    highest_deg: float,
) -> Array:
    key, values = per_joint
    checked_number(*scalar, lower=0.0, unit="deg")
    if len(values) == 0:
        key, values = scalar[0], [scalar[1]] * len(ARM_JOINTS)
    elif len(values) != len(ARM_JOINTS):
        reason = f"has {len(values)} entries, but the arm has {len(ARM_JOINTS)} joints"
        raise ConfigError(key, list(values), reason)
    caps = np.array(base)
    for i, value in enumerate(values):
        checked_number(key, value, lower=0.0, unit="deg")
        if value == 0.0:
            continue
        if value < _SLOWEST_DEG:
            raise ConfigError(key, value, f"must be at least {_SLOWEST_DEG}, or 0 for no cap")
        caps[i] = to_rad(min(value, highest_deg))
    return caps


# Extra parameters


def from_goal_metric(extra: Mapping[str, object]) -> GoalMetric:
    """Read how much of a pose counts from ``extra.goal_metric_type``.

    Position only by default, because five joints cannot reach most full poses. ``squared_norm``,
    the builtin motion service's name for the full pose, is accepted too.
    """
    value = extra.get("goal_metric_type", GoalMetric.POSITION_ONLY.value)
    if value == "squared_norm":
        return GoalMetric.FULL_POSE
    try:
        return GoalMetric(value)
    except ValueError:
        names = (*(metric.value for metric in GoalMetric), "squared_norm")
        raise ConfigError("goal_metric_type", value, suggest(str(value), names)) from None


def flag(extra: Mapping[str, object], key: str, default: bool) -> bool:
    value = extra.get(key, default)
    if not isinstance(value, bool):
        raise ConfigError(key, value, "must be true or false")
    return value


# Structs


def from_struct(struct: Any) -> dict[str, object]:
    """A Struct as plain values; null stays None, which the SDK's own reader turns into 0."""
    return {key: _from_value(value) for key, value in struct.fields.items()}


def _from_value(value: Any) -> object:
    kind = value.WhichOneof("kind")
    if kind == "struct_value":
        return from_struct(value.struct_value)
    if kind == "list_value":
        return [_from_value(entry) for entry in value.list_value.values]
    if kind in (None, "null_value"):
        return None
    return getattr(value, kind)


def to_result(values: Mapping[str, Any]) -> dict[str, Any]:
    """Prepare ``values`` for the wire: leaves out None and numbers that are not finite."""
    return {key: inner for key, value in values.items() if (inner := _plain(value)) is not None}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return to_result(value)
    if isinstance(value, (list, tuple, np.ndarray)):
        entries = [_plain(entry) for entry in value]
        return None if any(entry is None for entry in entries) else entries
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value


# Errors

STATUS: dict[type[So101Error], Status] = {
    So101Error: Status.UNKNOWN,
    ConfigError: Status.INVALID_ARGUMENT,
    errors.PlanningError: Status.FAILED_PRECONDITION,
    errors.OutsideLimits: Status.OUT_OF_RANGE,
    errors.BusError: Status.UNAVAILABLE,
    errors.OtherCalibration: Status.FAILED_PRECONDITION,
    errors.CorruptReply: Status.DATA_LOSS,
    errors.ServoFault: Status.FAILED_PRECONDITION,
    errors.MotionError: Status.ABORTED,
    errors.NotHolding: Status.FAILED_PRECONDITION,
    errors.CalibrationError: Status.FAILED_PRECONDITION,
    errors.NotPossibleNow: Status.FAILED_PRECONDITION,
    errors.MotorSetupError: Status.FAILED_PRECONDITION,
    errors.MachineUnavailable: Status.UNAVAILABLE,
    errors.SurroundingsUnknown: Status.UNAVAILABLE,
    errors.WorkerError: Status.INTERNAL,
}
"""The gRPC status of each error and of those derived from it; see also ``grpc_error``."""


def grpc_error(error: So101Error) -> GRPCError:
    """The gRPC status and message for ``error``.

    A motion that a newer one replaced is ABORTED; one that was stopped, cancelled by its caller or
    ended with its component is CANCELLED.
    """
    status = next(STATUS[cls] for cls in type(error).__mro__ if cls in STATUS)
    if isinstance(error, errors.Interrupted) and error.by != errors.SUPERSEDED:
        status = Status.CANCELLED
    message = str(error)
    if isinstance(error, errors.InCollision) and error.can_back_out:
        message += '; the command "leave_contact" backs it out'
    return GRPCError(status, on_the_wire(message))


LONGEST_ON_THE_WIRE = 1_500
"""Most bytes of a message as gRPC encodes it, three for each byte that is not ASCII. Chosen: the
time its trailer takes to encode grows with the square of this, 0.5 ms here, 0.6 s for 50,000."""


def on_the_wire(message: str) -> str:
    """A message as one line that gRPC carries without delay."""
    line = clipped(" ".join(message.split()), errors.LONGEST_MESSAGE)
    most = errors.LONGEST_MESSAGE
    while len(encode_grpc_message(_valid(line))) > LONGEST_ON_THE_WIRE:
        most -= 50
        line = clipped(line, most)
    return _valid(line)


def _valid(line: str) -> str:
    return line.encode("utf-8", "replace").decode()


@contextmanager
def grpc_statuses() -> Iterator[None]:
    """Turn our errors in this block into gRPC statuses."""
    try:
        yield
    except So101Error as error:
        raise grpc_error(error) from error
