"""Fit pitch and roll so that the tool's orientation is nearest to a wanted one, for a given pan.

With the pan given, two rotations are left: about the lift axis by the pitch, then about the roll
axis by the roll. In axes along these (roll axis first, lift axis second) and with half angles,
their product is the quaternion ``(c c', c s', s c', -s s')``, where c, s belong to the pitch and
c', s' to the roll. Its inner product with the wanted quaternion (w, x, y, z), the cosine of half
the remaining angle, is

    1/2 [(w + z) cos S + (x + y) sin S] + 1/2 [(w - z) cos D + (y - x) sin D]

with S half the sum and D half the difference of pitch and roll. Each bracket is largest where its
angle is that of the vector of its coefficients, which is the solution.
"""

from __future__ import annotations

from math import atan2, cos, remainder, sin

from so101_motion.common.geometry import Array, quaternion_wxyz
from so101_motion.planning.kinematics.arm_geometry import Measures
from so101_motion.planning.kinematics.planar_3r import TAU

Quaternion = tuple[float, float, float, float]


class Orientation:
    """A wanted rotation of the tool; finds the nearest pitch and roll."""

    def __init__(self, measures: Measures, R_base_tool: Array) -> None:
        self._pan_sign = measures.pan_sign
        axes = _quaternion(measures.R_base_axes)
        self._left = _inverse(axes)
        self._right = _times(_quaternion(R_base_tool @ measures.R_base_tool.T), axes)

    def pitch_and_roll(self, pan: float) -> tuple[float, float]:
        """The pitch and roll [rad] that come nearest with a given pan [rad]."""
        w, x, y, z = self._remaining(pan)
        half_sum, half_difference = atan2(x + y, w + z), atan2(y - x, w - z)
        return (
            remainder(half_sum + half_difference, TAU),
            remainder(half_sum - half_difference, TAU),
        )

    def roll(self, pan: float, pitch: float) -> float:
        """The roll [rad] that comes nearest with a given pan and pitch [rad]."""
        w, x, y, z = self._remaining(pan)
        c, s = cos(0.5 * pitch), sin(0.5 * pitch)
        return remainder(2.0 * atan2(x * c - z * s, w * c + y * s), TAU)

    def pitch(self, pan: float, roll: float) -> float:
        """The pitch [rad] that comes nearest with a given pan and roll [rad]."""
        w, x, y, z = self._remaining(pan)
        c, s = cos(0.5 * roll), sin(0.5 * roll)
        return remainder(2.0 * atan2(y * c - z * s, w * c + x * s), TAU)

    def _remaining(self, pan: float) -> Quaternion:
        half = -0.5 * self._pan_sign * pan
        return _times(_times(self._left, (cos(half), 0.0, 0.0, sin(half))), self._right)


def _quaternion(R: Array) -> Quaternion:
    w, x, y, z = quaternion_wxyz(R).tolist()
    return w, x, y, z


def _inverse(a: Quaternion) -> Quaternion:
    return a[0], -a[1], -a[2], -a[3]


def _times(a: Quaternion, b: Quaternion) -> Quaternion:
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
