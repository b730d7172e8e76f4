"""The Feetech STS3215 as it looks from outside: case, horns, and where the six sit in the arm.

Modelled by us from the data sheet's outer figures (45.2 x 24.7 x 35 mm, horns of 20 mm); no
maker's model is used, so no maker's licence applies. Lengths in millimetres.
"""

import math

from manifold3d import Manifold

from .solids import disc, joined, outline, placed, prism, rectangle, softened

HALF_LENGTH = 22.7
HALF_WIDTH = 12.4
SHAFT = 12.5  # from the middle of the case, along +x
TOP, BOTTOM = 17.0, -15.9  # of the case, along the shaft

_TURN = math.pi / 2

# xyz [mm] and rpy [rad] of the case in the frame of the link that carries it.
POSES: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "base": ((26.3353, 0.0, 43.7), (0.0, 0.0, 0.0)),
    "shoulder": ((-30.3992, 0.4222, -41.7), (_TURN, _TURN, 0.0)),
    "upper_arm": ((-112.57, -15.5, 18.7), (math.pi, 0.0, -_TURN)),
    "lower_arm": ((-122.4, 5.2, 18.7), (math.pi, 0.0, math.pi)),
    "wrist": ((0.0, -42.4, 30.6), (_TURN, _TURN, 0.0)),
    "gripper": ((7.7, 0.1, -23.4), (-_TURN, 0.0, 0.0)),
}


def case() -> Manifold:
    """Build the case in its own frame: centre at the origin, shaft along +z at x = 12.5."""
    length, width = HALF_LENGTH, HALF_WIDTH

    # The two corners at the shaft end are cut wider than those at the cable end.
    edge = outline(
        [
            (-length, -width, 2.0),
            (length, -width, 4.0),
            (length, width, 4.0),
            (-length, width, 2.0),
        ]
    )
    shell = softened(prism("xy", edge, BOTTOM, TOP), 0.8)
    # The case is screwed together from three layers; the seams show.
    seams = joined(
        prism("xy", edge.offset(1.0) - edge.offset(-0.35), z - 0.2, z + 0.2) for z in (-8.4, 9.2)
    )
    shell -= seams
    gear_cover = prism("xy", disc(SHAFT, 0.0, 9.8, 24), 16.0, 17.3)
    idler = prism("xy", disc(SHAFT, 0.0, 7.5, 20), -16.9, -15.0)
    plugs = prism("xy", rectangle(-18.0, -8.0, -9.0, 9.0, 1.0), -17.6, -15.0)
    sockets = joined(
        prism("xy", rectangle(-16.8, -9.2, v - 3.6, v + 3.6), -18.0, -16.4) for v in (-4.3, 4.3)
    )
    screws = joined(
        prism("xy", disc(u, v, 1.5, 8), 16.5, 18.0) for u in (-19.8,) for v in (-9.3, 9.3)
    )
    return joined([shell, gear_cover, idler, plugs]) - sockets - screws


def horns() -> Manifold:
    """Build the driven horn and the idler opposite, with their screws, in the case's frame."""
    discs = [
        prism("xy", disc(SHAFT, 0.0, 10.0, 30), 16.9, 18.7),
        prism("xy", disc(SHAFT, 0.0, 10.0, 30), -17.7, -16.5),
        prism("xy", disc(SHAFT, 0.0, 2.9, 12), 18.0, 20.2),
        prism("xy", disc(SHAFT, 0.0, 2.9, 12), -19.4, -17.0),
    ]
    slots = [
        prism("xy", rectangle(SHAFT - 1.7, SHAFT + 1.7, -0.5, 0.5), 19.4, 21.0),
        prism("xy", rectangle(SHAFT - 0.5, SHAFT + 0.5, -1.7, 1.7), 19.4, 21.0),
    ]
    return joined(discs) - joined(slots)


def servo_of(part: str) -> dict[str, Manifold]:
    """Build the servo that sits in a part, keyed by material."""
    return {
        "servo": placed(case(), *POSES[part]),
        "horn": placed(horns(), *POSES[part]),
    }
