"""Shapes that belong to no link: the leader's handle and trigger, and the tool's axes.

The leader arm carries a handle and a trigger where the follower has its jaws. Both here are our
own design from a description alone (a grip with a loop for the hand, a trigger on the sixth
servo): recognisable, not a copy, and not for measuring. Lengths in millimetres.
"""

from collections.abc import Callable

from manifold3d import Manifold

from .servo import servo_of
from .solids import (
    GAP,
    HUB,
    Solids,
    bolt_circle,
    box,
    disc,
    joined,
    outline,
    prism,
    rectangle,
    softened,
    views,
)

AXIS_LENGTH = 17.5  # of the published module's tool marker


def leader_body() -> Solids:
    """The palm of the gripper with a closed loop to hold, in the gripper link's frame."""
    palm = views(
        xz=outline(
            [
                (-35.2, -40.0, 4.0),
                (-35.2, -5.0, 5.0),
                (30.2, -5.0, 3.0),
                (30.2, -11.0, 2.0),
                (15.0, -11.2, 2.0),
                (2.0, -40.0, 2.0),
            ]
        ),
        yz=rectangle(-24.0, 24.0, -40.0, -5.0, 6.0),
    )
    palm = softened(palm, 1.5) - box(-15.2, 60.0, -19.7, 20.7, -60.0, -10.9)
    flange = softened(prism("xy", disc(0.0, 0.0, HUB, 36), -9.0, 1.0), 0.6)
    palm = joined([palm, flange]) - bolt_circle("xy", 0.0, 0.0)
    loop = outline(
        [(-36.0, -30.0, 8.0), (-48.0, -66.0, 30.0), (-36.0, -112.0, 22.0), (-4.0, -112.0, 22.0),
         (4.0, -66.0, 30.0), (-8.0, -34.0, 8.0)]
    )  # fmt: skip
    hole = outline([(-30.0, -48.0, 9.0), (-36.0, -68.0, 20.0), (-29.0, -101.0, 12.0),
                    (-12.0, -101.0, 12.0), (-8.0, -68.0, 20.0), (-14.0, -48.0, 9.0)])  # fmt: skip
    grip = softened(prism("xz", loop - hole, -10.0, 10.0), 3.0)
    return {"print": joined([palm, grip]), **servo_of("gripper")}


def leader_trigger() -> Solids:
    """The lever the forefinger pulls, in the moving jaw's frame."""
    lever = views(
        xy=outline(
            [
                (-10.0, 0.0),
                (-9.0, -22.0, 12.0),
                (-4.0, -44.0, 20.0),
                (-8.0, -66.0, 8.0),
                (2.0, -68.0, 5.0),
                (9.0, -44.0, 24.0),
                (9.0, -20.0, 12.0),
                (10.0, 0.0),
            ]
        )
        + disc(0.0, 0.0, 10.0),
        yz=outline(
            [
                (10.0, 42.9, 2.0),
                (-8.0, 42.9, 4.0),
                (-20.5, 38.4, 6.0),
                (-28.0, 27.0, 10.0),
                (-68.0, 26.0, 5.0),
                (-68.0, 11.8, 5.0),
                (-28.0, 10.8, 10.0),
                (-20.5, -1.2, 6.0),
                (-8.0, -5.1, 4.0),
                (10.0, -5.1, 2.0),
                (10.0, 0.0),
                (-7.0, 0.0, 6.0),
                (-15.2, 5.5, 5.0),
                (-15.2, 32.0, 5.0),
                (-7.0, GAP, 6.0),
                (10.0, GAP),
            ]
        ),
    )
    return {"accent": softened(lever, 1.6) - bolt_circle("xy", 0.0, 0.0, circle=6.4, radius=1.4)}


def axes() -> Solids:
    """Three arrows along x, y and z from the origin."""
    tip = 4.5
    arrow = joined(
        [
            Manifold.cylinder(AXIS_LENGTH - tip, 0.7, 0.7, 12),
            Manifold.cylinder(tip, 1.7, 0.0, 16).translate((0.0, 0.0, AXIS_LENGTH - tip)),
        ]
    )
    return {
        "x": arrow.rotate((0.0, 90.0, 0.0)),
        "y": arrow.rotate((-90.0, 0.0, 0.0)),
        "z": arrow,
    }


MARKERS: dict[str, Callable[[], Solids]] = {
    "leader_body": leader_body,
    "leader_trigger": leader_trigger,
    "axes": axes,
}
