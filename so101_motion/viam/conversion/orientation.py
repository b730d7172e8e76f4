"""Convert orientation vectors exactly as viam-server does.

An orientation vector is a direction ``o`` and a turn ``theta`` about it. With longitude and
latitude of ``o`` (latitude counted from +z) the rotation is ``Rz(lon) Ry(lat) Rz(theta)``, so ``o``
is its third column. Near the poles longitude and theta turn about almost the same axis, and
viam-server fixes the longitude to zero there, in both directions. So within 0.8 degrees of straight
up or down the direction of the tilt is lost. Client and server must mean the same by four numbers.

Source: viam-server's spatialmath, checked against its frame system on 240 poses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from so101_motion.common.geometry import Array, rot_y, rot_z

POLE = 1e-4
"""How close ``|o_z|`` is to 1 where the longitude is fixed to zero; viam-server's figure."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OrientationVector:
    """The direction of the third axis, unit length, and the turn about it, -pi to pi [rad]."""

    o: tuple[float, float, float]
    theta: float


def to_rotation(vector: OrientationVector) -> Array:
    """The rotation matrix of an orientation vector; zero length stands for +z."""
    x, y, z = vector.o
    length = math.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return rot_z(vector.theta)
    longitude = 0.0 if 1.0 - abs(z) / length <= POLE else math.atan2(y, x)
    latitude = math.atan2(math.hypot(x, y), z)  # accurate near the poles, where acos is not
    return rot_z(longitude) @ rot_y(latitude) @ rot_z(vector.theta)


def from_rotation(R: Array) -> OrientationVector:
    """The orientation vector of a rotation matrix, shape (3, 3)."""
    x, y, z = (float(value) for value in R[:, 2])
    sine, cosine = (R[1, 0], R[1, 1]) if 1.0 - abs(z) <= POLE else (R[2, 1], -R[2, 0])
    return OrientationVector(o=(x, y, z), theta=math.atan2(sine, cosine))
