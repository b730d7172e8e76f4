"""The two links that grip: the gripper with its fixed finger, and the jaw."""

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
    mirrored,
    outline,
    prism,
    softened,
    views,
)


def gripper() -> Solids:
    """The palm that turns on the roll horn, and the fixed finger below it."""
    plan = outline(
        mirrored(
            [
                (-35.2, 15.0, 3.0),
                (-26.0, 16.5, 6.0),
                (-12.0, 24.0, 8.0),
                (22.0, 24.0, 6.0),
                (30.2, 16.0, 6.0),
            ],
            flip="v",
        )
    )
    palm = views(
        xy=plan,
        xz=outline(
            [
                (-35.2, -38.0),
                (-35.2, -5.0, 4.0),
                (30.2, -5.0, 3.0),
                (30.2, -11.0, 2.0),
                (15.0, -11.2, 2.0),
                (2.0, -38.0, 2.0),
            ]
        ),
        yz=outline(
            mirrored([(24.0, -5.0, 4.0), (24.0, -28.0, 5.0), (20.5, -38.0, 2.0)], flip="u"),
        ),
    )
    palm = softened(palm, 1.5) - box(-15.2, 60.0, -19.7, 20.7, -60.0, -10.9)
    flange = softened(prism("xy", disc(0.0, 0.0, HUB, 36), -9.0, 1.0), 0.6)
    palm = joined([palm, flange]) - bolt_circle("xy", 0.0, 0.0)
    palm -= prism("yz", disc(0.1, -23.4, 4.5, 24), -60.0, -10.0)
    clip = softened(box(0.0, 11.5, -28.0, -20.0, -11.0, -5.0), 0.8)
    clip -= box(3.5, 8.0, -26.0, -24.0, -30.0, 0.0)
    finger = softened(_finger(), 1.0) - joined(
        prism("xz", disc(-18.2 + 0.09 * (-50.0 - z), z, 1.0, 10)) for z in (-50, -60, -70, -80)
    )
    return {"print": joined([palm, finger, clip]), **servo_of("gripper")}


def _finger() -> Manifold:
    """The fixed finger: straight steps on the pad's side, tapering in both views."""
    return views(
        xz=outline(
            [
                (-15.0, -30.0),
                (-15.0, -45.0),
                (-13.3, -45.2),
                (-13.3, -65.0),
                (-11.6, -65.2),
                (-11.6, -84.2),
                (-9.8, -84.4),
                (-9.8, -94.4),
                (-7.8, -94.6),
                (-7.8, -104.4, 1.2),
                (-13.0, -103.2, 3.0),
                (-35.2, -43.0, 6.0),
                (-35.2, -30.0),
            ]
        ),
        yz=outline(
            mirrored(
                [(17.0, -30.0), (16.0, -37.0, 6.0), (11.6, -46.0, 14.0), (3.6, -104.4, 3.2)],
                flip="u",
            )
        ),
    )


def jaw() -> Solids:
    """The moving jaw: a fork on the gripper servo that closes into a finger."""
    middle = 18.9
    finger = views(
        xy=outline(
            [
                (-10.0, 0.0),
                (-10.0, -16.0, 8.0),
                (-8.4, -30.0, 20.0),
                (-8.4, -61.8),
                (-10.4, -62.2),
                (-10.4, -71.6),
                (-12.2, -72.0),
                (-12.2, -82.0, 1.2),
                (-8.4, -82.0, 2.0),
                (4.0, -59.0, 12.0),
                (8.6, -23.0, 10.0),
                (10.0, 0.0),
            ]
        )
        + disc(0.0, 0.0, 10.0),
        yz=outline(
            [
                (10.0, 42.9, 2.0),
                (-8.0, 42.9, 4.0),
                (-20.5, 38.4, 4.0),
                (-24.0, 30.2, 8.0),
                (-74.0, 24.2, 6.0),
                (-82.0, middle + 2.6, 2.4),
                (-82.0, middle - 2.6, 2.4),
                (-74.0, 13.2, 6.0),
                (-24.0, 7.8, 8.0),
                (-20.5, -1.2, 4.0),
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
    finger = softened(finger, 1.1) - bolt_circle("xy", 0.0, 0.0, circle=6.4, radius=1.4)
    finger -= joined(
        prism("xy", disc(0.6 - 0.085 * (-30.0 - y), y, 0.9, 10)) for y in (-32, -42, -52, -62)
    )
    return {"accent": finger}
