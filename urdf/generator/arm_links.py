"""The three links between shoulder and hand: upper arm, forearm and wrist."""

from manifold3d import CrossSection, Manifold

from .servo import servo_of
from .solids import (
    GAP,
    HUB,
    MIDDLE,
    Corner,
    Solids,
    bolt_circle,
    box,
    diamonds,
    disc,
    joined,
    mirrored,
    outline,
    prism,
    rectangle,
    softened,
    views,
)


def _wishbone(
    *,
    length: float,
    flange: float,
    block: float,
    waist: float,
    shoulder_x: float,
    nose: tuple[float, float],
) -> Manifold:
    """Two prongs that grow together: the upper arm and the forearm.

    Args:
        length: From the axis to the far end, along -x.
        flange: Thickness of a prong at the hinge.
        block: Thickness outside the gap where the prongs have joined.
        waist: Where the thickness begins to fall, along -x.
        shoulder_x: Where it has fallen to ``block``.
        nose: Where the upper prong begins to thin towards its tip, and its thickness there.
    """
    upper: list[Corner] = [
        (12.0, GAP),
        (-16.0, GAP - 0.4, 60.0),
        (-44.0, GAP - 9.0, 12.0),
        (-51.0, MIDDLE, 9.0),
    ]
    outer: list[Corner] = [
        (-length, GAP + block, 3.0),
        (-shoulder_x, GAP + block, 40.0),
        (-waist, GAP + flange, 40.0),
    ]

    def below(corner: Corner) -> Corner:
        return (corner[0], GAP - corner[1], *corner[2:])

    side = outline(
        upper
        + [below(corner) for corner in reversed(upper[:-1])]
        + [(12.0, -flange)]
        + [below(corner) for corner in reversed(outer)]
        + outer
        + [(nose[0], GAP + flange, 8.0), (12.0, GAP + nose[1])]
    )
    solid = views(
        xz=side,
        xy=rectangle(-length, 0.0, -12.0, 12.0) + disc(0.0, 0.0, HUB),
    )
    return softened(solid, 3.2) - bolt_circle("xy", 0.0, 0.0)


def upper_arm() -> Solids:
    """From the lift axis to the elbow servo, which sits across the arm's end."""
    arm = _wishbone(
        length=130.2, flange=13.5, block=6.8, waist=56.0, shoulder_x=92.0, nose=(9.0, 10.0)
    )
    window = prism("xz", _window(-75.5, -94.5))
    pocket = box(-125.3, -99.8, -60.0, 7.5, 1.2, 35.2)
    opening = box(-140.0, -120.0, -60.0, 4.0, 9.0, 27.4)
    pattern = diamonds(
        "xz", [-124.0, -116.4, -108.8, -101.2], [7.0, 14.4, 22.0, 29.4], 2.2, 6.0, 30.0
    )
    clip = softened(box(-26.0, -16.0, -5.5, 4.5, 47.0, 53.8), 1.0) - box(
        -30.0, -10.0, -2.5, 1.5, 49.9, 52.0
    )
    return {"print": arm - window - pocket - opening - pattern + clip, **servo_of("upper_arm")}


def _window(near: float, far: float) -> CrossSection:
    """The opening behind the fork, a hexagon pointing at the hinge."""
    step = near - 5.0
    return outline(
        [(near, MIDDLE), (step, 11.0), (far, 10.2), (far, GAP - 10.2), (step, GAP - 11.0)],
        radius=2.5,
    )


def lower_arm() -> Solids:
    """From the elbow to the wrist servo, which a ring clamps along the arm."""
    arm = _wishbone(
        length=117.0, flange=12.0, block=7.0, waist=38.0, shoulder_x=54.0, nose=(-8.0, 5.0)
    )
    window = prism("xz", _window(-66.0, -92.0))
    pocket = box(-160.0, -99.3, -7.6, 17.9, 1.2, 35.2)
    ring = prism(
        "yz",
        rectangle(-15.0, 20.8, -8.2, 44.2, 7.0) - rectangle(-11.6, 18.4, -4.8, 40.8, 4.0),
        -118.7,
        -90.7,
    )
    ring = softened(ring, 0.9)
    ring -= diamonds("xz", [-109.5, -100.0], [4.6, 13.6, 22.6, 31.6], 2.4, 10.0, 40.0)
    clip = softened(box(-21.0, -11.0, -6.0, 5.0, 45.0, 52.4), 1.0)
    clip -= box(-30.0, -5.0, -2.5, 1.5, 48.4, 50.5)
    return {
        "print": arm - window - pocket + clip,
        "accent": ring,
        **servo_of("lower_arm"),
    }


def wrist() -> Solids:
    """A fork on the wrist servo that widens into the box of the roll servo."""
    side = outline(
        [
            (12.0, GAP - 0.2),
            (-22.0, GAP - 0.2, 2.0),
            (-22.0, 12.0, 12.0),
            (-8.0, 0.0, 10.0),
            (12.0, 0.0),
            (12.0, -9.0, 3.0),
            (-36.0, -9.0, 40.0),
            (-62.3, 24.0, 40.0),
            (-62.3, 53.3, 2.0),
            (-23.0, 53.3, 6.0),
            (-10.0, 45.4, 10.0),
            (12.0, 44.7, 3.0),
        ]
    )
    body = views(
        yz=side,
        xy=outline(
            [
                (-15.5, -62.3, 3.0),
                (-15.5, -26.0, 5.0),
                (-12.0, -19.0, 8.0),
                (-12.0, 0.0),
                (12.0, 0.0),
                (12.0, -19.0, 8.0),
                (15.6, -26.0, 5.0),
                (15.6, -62.3, 3.0),
            ]
        )
        + disc(0.0, 0.0, HUB),
        xz=outline(
            mirrored([(15.5, 56.0), (15.5, 9.0, 12.0), (11.0, -9.0, 4.0)], flip="u"),
        ),
    )
    body = softened(body, 1.5) - bolt_circle("xy", 0.0, 0.0)
    cavity = box(-12.6, 12.6, -59.4, -24.0, 7.7, 80.0)
    throat = prism(
        "xz",
        outline([(-11.0, 80.0), (-11.0, 8.0, 6.0), (11.0, 8.0, 6.0), (11.0, 80.0)]),
        -80.0,
        -50.0,
    )
    slits = joined(
        prism(
            "yz",
            outline(
                [(y - 5.5, 33.0), (y - 2.0, 30.0), (y + 6.0, 40.5), (y + 2.5, 43.5)], radius=1.0
            ),
        )
        for y in (-48.5, -36.0)
    )
    hook = softened(box(-20.0, -14.0, -54.0, -40.0, 9.0, 21.0), 0.8)
    hook -= box(-25.0, -16.2, -49.2, -44.8, 0.0, 30.0)
    stop = softened(box(-15.0, -9.0, -65.8, -60.0, 30.4, 37.0), 0.8)
    return {"print": joined([body - cavity - throat - slits, hook, stop]), **servo_of("wrist")}
