"""The state of one side of a teleoperation at one instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from so101_motion.common.geometry import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SideState:
    """The joints of a side, and what it does."""

    x: Array  # joint angles [rad], and the aperture of the jaw, 0 to 1, shape (6,)
    x_goal: Array  # their setpoints, likewise; the measured values where nothing is driven
    # share of full drive of each servo, base to jaw, -1 to 1; empty where not known
    loads: Sequence[float] = ()
    needs_recovery: bool = False  # whether there is work to do that takes a moment; see ``recover``
    is_limp: bool = False  # whether it can be moved by hand
    is_there: bool = True  # whether it answers
    is_engaged: bool = False  # whether it follows the pilot
    # what is in its way, such as ``"the jaw close to the floor"``, as far as it knows
    held_by: tuple[str, ...] = ()
    is_gripping: bool = False  # whether the jaw has closed on something, as far as it knows
