"""The built-in named poses: home, ready and rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from so101_motion.common.encoder_zeros import EncoderZeros
from so101_motion.common.geometry import Array, frozen_array
from so101_motion.common.units import to_rad


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NamedPose:
    """Joint angles with a name."""

    name: str  # what people call it
    q: Array  # joint angles, shape (5,), [rad]
    # the zeros of the arm that it was saved with; None if not known
    zeros: EncoderZeros | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", frozen_array(self.q, (5,)))


def _pose(name: str, *q_deg: float) -> NamedPose:
    return NamedPose(name=name, q=to_rad(np.array(q_deg)))


POSES = (
    _pose("home", 0, 0, 0, 0, 0),
    _pose("ready", 0, -45, 45, 60, 0),
    _pose("rest", 0, -92, 78, 60, 0),
)
"""Chosen. Home: all joints at zero. Ready: over the table, looking down. Rest: folded, with 18 mm
between the forearm and the shoulder. A test proves them free of collisions."""
