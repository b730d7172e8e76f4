"""Track joints outside their limits: where the next motion brings them in, and what is refused.

A joint may stand outside its limits, where no goal can keep it (``JointReading.out_of_range``). It
stays there until a motion of its channel begins. Motions are planned from the nearest angle inside
and wait until its servo has brought it there, slowly. That path is not checked for collisions, so a
long one is refused.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.errors import MotionError
from so101_motion.common.geometry import Array
from so101_motion.common.state import JointReading
from so101_motion.common.units import to_deg, to_rad

FARTHEST_OUT = to_rad(10.0)
"""A joint farther outside its limits than this is not brought in [rad]; most likely its calibration
is wrong. Chosen: such a path takes the stretched arm's tip 70 mm."""

RECOVERY_TIME = 5.0
"""How long coming in may take [s]: thrice what a servo needs from ``FARTHEST_OUT``. Chosen."""


class LimitRecovery:
    """The joints of a channel that are outside their limits; I/O thread only.

    Attributes:
        mask: Which of them are outside.
        is_needed: Whether any is.
    """

    def __init__(self, joints: tuple[str, ...]) -> None:
        self.mask: NDArray[np.bool_] = np.zeros(len(joints), dtype=bool)
        self._joints = joints
        self._q: Array = np.zeros(len(joints))
        self._inside: Array = self._q
        self.is_needed = False

    def update(self, q: Array, out_of_range: Mapping[str, float]) -> None:
        """Note the joints, shape (n,), [rad], and where those outside will be taken [rad]."""
        self._q = q
        named = zip(self._joints, q, strict=True)
        self._inside = np.array([out_of_range.get(joint, here) for joint, here in named])
        self.mask = np.isin(self._joints, list(out_of_range))
        self.is_needed = bool(self.mask.any())

    def inside(self, q: Array) -> Array:
        """``q``, shape (n,), [rad], with joints that are outside where they will be taken to."""
        return np.where(self.mask, self._inside, q)

    def left_alone(self, q: Array) -> Array:
        """``q``, shape (n,), [rad], with joints that are outside where they are now."""
        return np.where(self.mask, self._q, q)

    def farthest(self) -> tuple[str, float]:
        """The joint that is farthest outside, and by how much [rad]."""
        off = np.abs(self._q - self.inside(self._q))
        i = int(np.argmax(off))
        return self._joints[i], float(off[i])

    def refuse_far(self) -> None:
        """Raise ``MotionError`` if a joint is far outside."""
        joint, off = self.farthest()
        if off > FARTHEST_OUT:
            raise MotionError(
                f"{joint} is {to_deg(off):.0f} deg outside its calibrated range, too far to move"
                " in by itself; move it inside by hand, or calibrate the arm again"
            )

    def refuse(self) -> None:
        """Raise ``MotionError`` for a motion that cannot wait, while a joint is outside."""
        if self.is_needed:
            raise MotionError(
                f"{self.farthest()[0]} is outside its calibrated range, so nothing can be streamed"
                " to it; move the arm somewhere first, which brings the joint in slowly"
            )


def remarks(reading: JointReading) -> list[str]:
    """Describe joints outside their limits to the user, one sentence each."""
    here, found = reading.angles, []
    for joint, inside in reading.out_of_range.items():
        off = abs(here[joint] - inside)
        then = (
            "the next move brings it in, slowly"
            if off <= FARTHEST_OUT
            else "move it inside by hand, or calibrate the arm again"
        )
        found.append(
            f"{joint} is {to_deg(off):.1f} deg outside its calibrated range and was left as it is;"
            f" {then}"
        )
    return found
