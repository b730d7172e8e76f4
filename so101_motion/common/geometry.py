"""Rigid transforms, rotations and the array type that all packages share.

``T_base_tool`` maps a point given in the tool frame to the base frame: ``T_base_tool @ p_tool``
is ``p_base``, and neighbouring names cancel. Metres and radians, right-handed frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import MISSING, dataclass, fields
from enum import Enum
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from so101_motion.common.errors import ConfigError
from so101_motion.common.public import Public, explained

Array = NDArray[np.float64]


def frozen_array(values: ArrayLike, shape: tuple[int, ...] | None = None) -> Array:
    """A read-only float copy of ``values``.

    Args:
        values: Anything numpy can read as numbers.
        shape: The shape it must have; ``-1`` matches any length.

    Raises:
        ValueError: The shape is another one.
    """
    array = np.array(values, dtype=np.float64)
    if shape not in (None, array.shape) and (
        array.ndim != len(shape)
        or any(want not in (-1, have) for want, have in zip(shape, array.shape, strict=True))
    ):
        raise ValueError(f"expected an array of shape {shape}, got {array.shape}")
    array.setflags(write=False)
    return array


def freeze(value: object, **shapes: tuple[int, ...]) -> None:
    """Make arrays of a frozen dataclass a ``frozen_array`` each; for its ``__post_init__``.

    Those that nobody can write are not copied.
    """
    for name, shape in shapes.items():
        given = getattr(value, name)
        if type(given) is np.ndarray and given.shape == shape and not given.flags.writeable:
            base: Any = given.base  # that of a view of a view is the one that has the memory
            is_fixed = base is None or type(base) is bytes or not base.flags.writeable
            if is_fixed and given.dtype.char == "d":
                continue
        object.__setattr__(value, name, frozen_array(given, shape))


class Brief(Public):
    """Base of dataclasses with ``repr=False``: shown without what is as by default."""

    __slots__ = ()

    def __init_subclass__(cls) -> None:
        if "__init__" in vars(cls):  # a dataclass with slots is made a second time, with it
            names = ", ".join(f"{each}=..." for each in vars(cls)["__dataclass_fields__"])
            cls.__init__ = explained(f"write {cls.__name__}({names})")(cls.__init__)  # type: ignore[method-assign]

    def __repr__(self) -> str:
        def shown(given: object) -> str:
            if isinstance(given, np.ndarray):
                few = given.size <= _FEW
                return str((given.round(4) + 0.0).tolist()) if few else f"array of {given.shape}"
            if isinstance(given, float):
                return f"{given:.4g}"
            return repr(given.value if isinstance(given, Enum) else given)

        said = []
        for each in fields(self):  # type: ignore[arg-type]  # a dataclass
            made = each.default_factory
            default = each.default if made is MISSING else made()
            if each.repr and (text := shown(getattr(self, each.name))) != shown(default):
                said.append(f"{each.name}={text}")
        return f"{type(self).__name__}({', '.join(said)})"


_FEW = 15  # most numbers of an array that are shown; chosen, three rows of joints

FARTHEST = 10.0  # [m]; goals beyond it are probably in millimetres; chosen

LARGEST = 100.0  # largest size and distance [m]; a larger number was probably meant as millimetres


def joint_angles(
    key: str, given: ArrayLike, shape: tuple[int, ...] = (5,), *, most: float = 2.0 * math.pi
) -> Array:
    """Joint angles of a calling program [rad]; ``ConfigError`` beyond ``most``, or not finite."""
    q = in_radians(key, given_array(key, given, shape, "joint angles in radians"), most)
    if not is_finite(q):
        raise ConfigError(key, q.tolist(), "must be finite angles [rad]")
    return q


def angle(key: str, given: float) -> float:
    """An angle of a calling program [rad]; ``ConfigError`` if it is not finite, or in degrees."""
    value = in_radians(key, given_array(key, given, (), "number of radians"))
    if not is_finite(value):
        raise ConfigError(key, given, "must be a finite angle [rad]")
    return float(value)


def point(key: str, given: ArrayLike, most: float = FARTHEST) -> Array:
    """A point of a calling program, shape (3,), [m]; ``ConfigError`` beyond ``most``."""
    return _check_place(key, given_array(key, given, (3,), "lengths in metres"), most)


def _check_place(key: str, p: Array, most: float) -> Array:
    if not all(abs(each) <= most for each in p.tolist()):
        in_metres(key, p, most)
        raise ConfigError(key, p.tolist(), "must be three finite numbers [m]")
    return p


def pose(key: str, given: Any, most: float = FARTHEST) -> SE3:
    """A pose of a calling program: an ``SE3``, Pinocchio's, or its matrix, shape (4, 4).

    ``ConfigError`` if it is none, its rotation is none, or it is beyond ``most`` [m].
    """
    if not isinstance(given, SE3):
        try:
            T = frozen_array(getattr(given, "homogeneous", given), (4, 4))
        except (TypeError, ValueError, OverflowError):
            reason = (
                "must be an SE3 or its matrix, 4 x 4; that of a point is"
                " SE3.from_translation((0.2, 0, 0.1))"
            )
            raise ConfigError(key, given, reason) from None
        given = SE3(T[:3, :3], T[:3, 3])
    found: SE3 = given
    _check_place(key, found.p, most)
    _check_rotation(key, found.R.tolist())
    return found


_SLACK = 1e-6  # of a rotation from orthonormal; chosen, seven digits


def _check_rotation(key: str, rows: list[list[float]]) -> None:
    (a, b, c), (d, e, f), (g, h, i) = rows  # plain floats are faster one by one
    # Two unit vectors at right angles, and their cross product; NaN is refused.
    if not (
        -_SLACK < a * a + b * b + c * c - 1.0 < _SLACK
        and -_SLACK < d * d + e * e + f * f - 1.0 < _SLACK
        and -_SLACK < a * d + b * e + c * f < _SLACK
        and -_SLACK < b * f - c * e - g < _SLACK
        and -_SLACK < c * d - a * f - h < _SLACK
        and -_SLACK < a * e - b * d - i < _SLACK
    ):
        reason = "the rotation must be a right-handed orthonormal matrix (3, 3); see SE3.from_rpy"
        raise ConfigError(key, rows, reason)


def in_radians(key: str, given: Array, most: float = 2.0 * math.pi, per: str = "") -> Array:
    """``given``; ``ConfigError`` if a value is finite and beyond ``most``."""
    if (far := _beyond(given, most)) is not None:
        reason = (
            f"{far:g} rad{per}: did you mean degrees? {far:g} deg{per} is"
            f" {math.radians(far):.4g} rad{per}"
        )
        raise ConfigError(key, given.tolist(), reason)
    return given


def in_metres(key: str, given: Array, most: float = FARTHEST, per: str = "") -> Array:
    """``given``; ``ConfigError`` if a value is finite and beyond ``most``."""
    if (far := _beyond(given, most)) is not None:
        reason = f"{far:g} m{per}: did you mean millimetres? {far:g} mm is {far / 1000.0:g} m"
        raise ConfigError(key, given.tolist(), reason)
    return given


def _beyond(given: Array, most: float) -> float | None:
    if not given.size or not most < np.abs(given).max() < math.inf:  # others refuse NaN
        return None
    return float(given.flat[np.abs(given).argmax()])


def given_array(key: str, given: ArrayLike, shape: tuple[int, ...], what: str) -> Array:
    """``frozen_array`` of what a calling program gives; ``ConfigError`` names what is expected."""
    try:
        return frozen_array(given, shape)
    except (TypeError, ValueError, OverflowError):
        count = "a " if not shape else "" if shape == (-1,) else f"{shape[-1]} "
        wanted = f"{'rows of ' if len(shape) == 2 else ''}{count}{what}"
        try:
            there = " x ".join(map(str, np.shape(given)))
        except ValueError:  # rows of different lengths
            there = "rows of different lengths"
        numbers = there == " x ".join(map(str, shape))  # as many, but not numbers
        seen = "" if numbers or not there else f"; these are {there}"
        if shape == (5,) and there in ("3", "6"):
            point = "; a point is so101.point(x, y, z)"
            seen += point if there == "3" else "; the jaw is for the gripper to move"
        raise ConfigError(key, given, f"must be {wanted}{seen}") from None


def _place(given: ArrayLike) -> Array:
    return given_array("p", given, (3,), "lengths in metres")


def _near_place(given: ArrayLike) -> Array:
    return in_metres("p", _place(given), LARGEST)


@dataclass(frozen=True, slots=True, eq=False)
class SE3(Public):
    """A rigid transform.

    Attributes:
        R: Rotation matrix, shape (3, 3).
        p: Translation, shape (3,), [m].
    """

    R: Array
    p: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "R", given_array("R", self.R, (3, 3), "numbers, a rotation"))
        object.__setattr__(self, "p", _place(self.p))

    def __repr__(self) -> str:
        at, turned = self.p.round(4) + 0.0, np.degrees(self.rpy).round(2) + 0.0
        return f"<SE3 at {tuple(at.tolist())} m, rpy {tuple(turned.tolist())} deg>"

    @classmethod
    def identity(cls) -> SE3:
        """The transform that changes nothing."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_translation(cls, p: ArrayLike) -> SE3:
        """A pure translation by ``p``, shape (3,), [m]; ``ConfigError`` beyond ``LARGEST``."""
        return cls(np.eye(3), _near_place(p))

    @classmethod
    def from_rpy(cls, rpy: Iterable[float], p: ArrayLike = (0.0, 0.0, 0.0)) -> SE3:
        """From roll, pitch, yaw [rad] as in URDF: ``Rz(yaw) Ry(pitch) Rx(roll)``.

        ``ConfigError`` if one is more than two turns: it is in degrees.
        """
        angles = given_array("rpy", tuple(rpy), (3,), "angles in radians")
        roll, pitch, yaw = in_radians("rpy", angles, 4.0 * math.pi)
        return cls(rot_z(yaw) @ rot_y(pitch) @ rot_x(roll), _near_place(p))

    @classmethod
    def from_quaternion(cls, wxyz: Iterable[float], p: ArrayLike = (0.0, 0.0, 0.0)) -> SE3:
        """From a quaternion (w, x, y, z) of any length but zero, and ``p``, shape (3,), [m]."""
        values = given_array("wxyz", tuple(wxyz), (4,), "numbers, a quaternion")
        if not 0.0 < (length := float(np.linalg.norm(values))) < math.inf:
            raise ConfigError("wxyz", values.tolist(), "must be finite, and not zero")
        w, x, y, z = values / length
        R = np.array(
            [
                [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
                [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
                [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
            ]
        )
        return cls(R, _near_place(p))

    @property
    def rpy(self) -> Array:
        """Roll, pitch and yaw as ``from_rpy`` takes them, shape (3,), [rad].

        Pitch is within -pi/2 to pi/2; straight up or down, roll is 0.
        """
        R = self.R
        level = math.hypot(R[2, 1], R[2, 2])
        pitch = math.atan2(-R[2, 0], level)
        if level < 1e-9:
            return np.array([0.0, pitch, math.atan2(-R[0, 1], R[1, 1])])
        return np.array([math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])])

    @property
    def matrix(self) -> Array:
        """The homogeneous matrix, shape (4, 4)."""
        T = np.eye(4)
        T[:3, :3] = self.R
        T[:3, 3] = self.p
        return T

    @property
    def inverse(self) -> SE3:
        """The transform that undoes this one."""
        return SE3(self.R.T, -self.R.T @ self.p)

    @overload
    def __matmul__(self, other: SE3) -> SE3: ...
    @overload
    def __matmul__(self, other: Array) -> Array: ...
    def __matmul__(self, other: SE3 | Array) -> SE3 | Array:
        """Compose with a transform, or map a point (3,) or points (n, 3)."""
        if isinstance(other, SE3):
            return SE3(self.R @ other.R, self.R @ other.p + self.p)
        points = np.asarray(other, dtype=np.float64)
        return np.asarray(points @ self.R.T + self.p)

    def quaternion_wxyz(self) -> Array:
        """The rotation as a unit quaternion (w, x, y, z) with w >= 0."""
        return quaternion_wxyz(self.R)


def rot_x(angle: float) -> Array:
    """Rotation about x by ``angle`` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rot_y(angle: float) -> Array:
    """Rotation about y by ``angle`` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rot_z(angle: float) -> Array:
    """Rotation about z by ``angle`` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def frame_along(z: ArrayLike) -> Array:
    """A rotation whose z axis points along ``z``, shape (3,), any length; its x axis is level.

    For a goal of which only the direction of approach counts. Straight up or down, x stays x.
    """
    axis = np.asarray(z, dtype=np.float64)
    axis = axis / np.linalg.norm(axis)
    level = np.cross(axis, (0.0, 0.0, 1.0))
    length = float(np.linalg.norm(level))
    x = level / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.column_stack([x, np.cross(axis, x), axis])


def rotation_vector(R: Array) -> Array:
    """The axis of a rotation times its angle, 0 to pi; shape (3,), [rad]."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R.tolist()  # plain floats are faster one by one
    sines = 0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy)
    sine = math.hypot(*sines)
    angle = math.atan2(sine, 0.5 * (xx + yy + zz - 1.0))
    if sine > 1e-6 or angle < 1.0:
        scale = angle / sine if sine > 1e-6 else 1.0
        return np.array(sines) * scale
    # Half a turn: R is 2 a a^T - 1, and either sign of the axis will do.
    column = int(np.argmax(np.diag(R)))
    axis = R[:, column] + np.eye(3)[column]
    return np.asarray(axis * (angle / np.linalg.norm(axis)))


def rotation_by(vector: ArrayLike) -> Array:
    """The rotation about an axis by an angle, given as their product, shape (3,), [rad].

    Source: O. Rodrigues' formula.
    """
    x, y, z = np.asarray(vector, dtype=np.float64).tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-9:
        return np.asarray(np.eye(3) + turn)
    half = math.sin(0.5 * angle) / (0.5 * angle)
    return np.asarray(
        np.eye(3) + (math.sin(angle) / angle) * turn + (0.5 * half * half) * (turn @ turn)
    )


def interpolated(T0: SE3, T1: SE3, share: float) -> SE3:
    """Interpolate between two poses: ``share`` of the straight line and of the rotation."""
    turn = rotation_vector(T0.R.T @ T1.R)
    return SE3(T0.R @ rotation_by(share * turn), T0.p + share * (T1.p - T0.p))


def rotation_angle(R: Array) -> float:
    """The angle of a rotation matrix, 0 to pi [rad]; accurate near both ends."""
    sine = 0.5 * math.sqrt(
        (R[2, 1] - R[1, 2]) ** 2 + (R[0, 2] - R[2, 0]) ** 2 + (R[1, 0] - R[0, 1]) ** 2
    )
    return math.atan2(sine, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0))


def quaternion_wxyz(R: Array) -> Array:
    """Unit quaternion (w, x, y, z) of a rotation matrix, with w >= 0.

    Source: S. W. Shepperd, Quaternion from rotation matrix, 1978: start from the largest component.
    """
    diagonal = np.diag(R)
    trace = float(diagonal.sum())
    choice = int(np.argmax([trace, *diagonal]))
    if choice == 0:
        q = np.array([1.0 + trace, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    else:
        i = choice - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q = np.empty(4)
        q[0] = R[k, j] - R[j, k]
        q[1 + i] = 1.0 + R[i, i] - R[j, j] - R[k, k]
        q[1 + j] = R[j, i] + R[i, j]
        q[1 + k] = R[k, i] + R[i, k]
    q /= math.sqrt(float(q @ q))
    return q if q[0] >= 0.0 else -q


def is_finite(values: Any) -> bool:
    return bool(np.isfinite(values).all())
