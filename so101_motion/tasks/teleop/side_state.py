"""The state of one side of a teleoperation at one instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from so101_motion.common.geometry import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SideState:
    """Measured and commanded joints.

    Attributes:
        x: Joint angles [rad], and the aperture of the jaw, 0 to 1, shape (6,).
        x_goal: Their setpoints, likewise; the measured values where nothing is driven.
        loads: Share of full drive of each servo, base to jaw, -1 to 1; empty where not known.
    """

    x: Array
    x_goal: Array
    loads: Sequence[float] = ()
