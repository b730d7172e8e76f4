"""The built-in named poses: home, ready and rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import so101_description

from so101_motion.common.encoder_zeros import EncoderZeros
from so101_motion.common.geometry import Array, freeze


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NamedPose:
    """Joint angles with a name."""

    name: str  # what people call it
    q: Array  # joint angles, shape (5,), [rad]
    # the zeros of the arm that it was saved with; None if not known
    zeros: EncoderZeros | None = None

    def __post_init__(self) -> None:
        freeze(self, q=(5,))


POSES = tuple(
    NamedPose(name=name, q=np.array(q)) for name, q in so101_description.ROBOT.poses.items()
)
"""From the robot file. Home: all joints at zero. Ready: over the table, looking down. Rest: folded,
with 18 mm between the forearm and the shoulder. A test proves them free of collisions."""
