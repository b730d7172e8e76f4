"""The state of one side of a teleoperation at one instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from so101_motion.common.geometry import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SideState:
    """The joints of a side, and what it does.

    Attributes:
        x: Joint angles [rad], and the aperture of the jaw, 0 to 1, shape (6,).
        x_goal: Their setpoints, likewise; the measured values where nothing is driven.
        loads: Share of full drive of each servo, base to jaw, -1 to 1; empty where not known.
        needs_recovery: Whether there is work to do that takes a moment; see ``recover``.
        is_limp: Whether it can be moved by hand.
        is_there: Whether it answers.
        is_engaged: Whether it follows the pilot.
        held_by: What is in its way, such as ``"the jaw close to the floor"``, as far as it knows.
        is_gripping: Whether the jaw has closed on something, as far as it knows.
    """

    x: Array
    x_goal: Array
    loads: Sequence[float] = ()
    needs_recovery: bool = False
    is_limp: bool = False
    is_there: bool = True
    is_engaged: bool = False
    held_by: tuple[str, ...] = ()
    is_gripping: bool = False
