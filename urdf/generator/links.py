"""The seven links, laid out by us from the arm's measured figures.

The figures (extents, axes, gaps, where a servo sits) are those of TheRobotStudio's SO-101; the
shapes between them are ours: plainer, with our own rounding. Each function returns the solids of
one link in that link's frame, keyed by material, in millimetres:

``print``   the main colour
``accent``  motor holders and the moving jaw, printed in a second colour
``servo``   the black case
``horn``    the discs on the servo's shaft and their screws

A rule that shapes most of the parts: between the two prongs that hold a horn there are always
36.4 mm, and a prong ends in a half disc of 12 mm round the axis.
"""

from collections.abc import Callable

from manifold3d import CrossSection, Manifold

from .servo import servo_of
from .solids import (
    Corner,
    Plane,
    bolt_circle,
    box,
    diamond,
    disc,
    joined,
    mirrored,
    outline,
    prism,
    rectangle,
    softened,
    views,
)

GAP = 36.4  # between the prongs, figure common to every hinge
MIDDLE = GAP / 2
HUB = 12.0  # radius of a prong's end

Solids = dict[str, Manifold]


def _diamonds(
    plane: Plane, us: list[float], vs: list[float], half: float, low: float, high: float
) -> Manifold:
    """The arm's hole pattern: a grid of diamonds."""
    return joined(prism(plane, diamond(u, v, half), low, high) for u in us for v in vs)


def base() -> Solids:
    """The foot with its two wings, the tower, the pan servo's holder and the board's plate."""
    foot = prism(
        "xy",
        outline(
            mirrored(
                [
                    (-22.3, 43.0, 3.0),
                    (-6.0, 43.0, 8.0),
                    (14.5, 55.5, 4.0),
                    (24.5, 55.5, 4.0),
                    (64.6, 32.5, 3.0),
                    (64.6, 23.0, 2.5),
                    (43.0, 10.5, 8.0),
                    (15.0, 9.5, 5.0),
                ],
                flip="v",
            )
        ),
        -2.4,
        15.1,
    )
    grid = [
        (x, y)
        for y in (18.0, 26.0, 34.0, 42.0)
        for x in (4.0, 12.0, 20.0, 28.0, 36.0, 44.0, 52.0)
        if _inside_wing(x, y)
    ]
    pattern = joined(
        prism("xy", diamond(x, side * y, 2.8), 10.5, 20.0) for x, y in grid for side in (1, -1)
    )
    # Feet: slots under the rim, so that the print stands on its edge.
    slots = joined(
        prism("xz", rectangle(x - 3.0, x + 3.0, -5.0, 1.6, 0.0)) for x in (-12.0, 6.0, 34.0, 50.0)
    )
    foot = softened(foot, 2.0) - pattern - slots

    tower = views(
        xz=outline(
            [
                (-22.3, 4.0),
                (-22.3, 69.5),
                (24.2, 69.5),
                (24.2, 61.0),
                (14.2, 61.0),
                (14.2, 27.0),
                (19.4, 27.0),
                (19.4, 4.0),
            ]
        ),
        yz=outline(
            mirrored([(22.3, 4.0), (22.3, 33.0, 3.0), (17.3, 38.0, 6.0), (17.3, 69.5)], flip="u")
        ),
        xy=outline(
            mirrored([(-22.3, 22.3, 4.0), (14.0, 22.3, 12.0), (24.2, 10.0, 10.0)], flip="v")
        ),
    )
    channel = prism("yz", rectangle(-9.2, 9.2, 7.0, 25.8, 2.0))
    eyelet = prism("xy", disc(-6.0, 0.0, 5.0, 24), 62.0, 80.0)
    tower = softened(tower, 1.6) - channel - eyelet

    ring = views(
        xz=outline(
            [
                (-27.0, 36.0, 2.0),
                (-27.0, 67.0, 2.5),
                (3.0, 67.0, 4.0),
                (8.0, 55.2, 5.0),
                (53.0, 55.2, 2.0),
                (53.0, 36.0, 2.0),
            ]
        ),
        xy=outline(mirrored([(-27.0, 22.2, 3.0), (6.0, 21.8, 10.0), (53.0, 15.9, 5.0)], flip="v"))
        - outline(mirrored([(-23.0, 17.4, 2.0), (8.0, 17.2, 6.0), (49.3, 12.6, 3.0)], flip="v")),
    )
    ring = softened(ring, 1.0) - joined(
        prism("xz", disc(x, 46.0, 1.5, 10)) for x in (-18.0, 18.0, 40.0)
    )
    plate = softened(prism("yz", rectangle(-25.4, 25.4, 26.4, 68.4, 6.0), -31.0, -27.2), 0.9)
    plate -= joined(prism("yz", disc(y, z, 1.6, 10)) for y in (-21.0, 21.0) for z in (31.0, 64.0))
    return {"print": joined([foot, tower, plate]), "accent": ring, **servo_of("base")}


def _inside_wing(x: float, y: float) -> bool:
    """Whether a diamond at (x, y) keeps a rim of the wing all round."""
    return y < 38.0 + min(0.6 * (x + 6.0), 0.58 * (64.6 - x) - 8.0, 12.5) and y > 4.0 + 0.36 * x


def shoulder() -> Solids:
    """The C that grips the pan horns from in front, and the lift servo's holder on top of it."""
    bracket = views(
        xz=outline(
            [
                (-47.6, -38.0, 1.0),
                (-47.6, 34.5, 2.0),
                (-36.0, 46.2, 4.0),
                (12.2, 46.2, 3.0),
                (12.2, GAP),
                (-16.0, GAP, 8.0),
                (-22.8, 31.0, 8.0),
                (-22.8, 4.5, 8.0),
                (-16.0, 0.0, 8.0),
                (12.2, 0.0),
                (12.2, -9.0, 3.0),
                (-18.0, -9.6, 2.0),
                (-18.6, -19.0),
                (-24.0, -19.0),
                (-24.6, -38.0),
            ]
        ),
        yz=outline(
            mirrored(
                [(23.0, -38.0), (23.0, -17.5, 4.0), (19.8, -10.5, 6.0), (19.8, 46.2, 6.0)], flip="u"
            )
        ),
        xy=outline(
            mirrored(
                [
                    (-47.6, 22.9, 4.5),
                    (-25.5, 22.9, 4.0),
                    (-22.5, 13.0, 6.0),
                    (-13.0, 11.4, 12.0),
                    (0.0, 12.2),
                ],
                flip="v",
            )
        )
        + disc(0.0, 0.0, 12.2),
    )
    bracket = softened(bracket, 1.8) - bolt_circle("xy", 0.0, 0.0)
    bracket -= joined(prism("yz", disc(y, 24.0, 2.4, 14), -60.0, -46.2) for y in (-11.0, 11.0))

    ring = prism(
        "xy",
        rectangle(-50.6, -15.0, -26.4, 26.4, 7.0) - rectangle(-47.3, -18.0, -23.1, 23.1, 4.5),
        -38.0,
        -10.0,
    )
    ring = softened(ring, 0.9)
    ring -= _diamonds("yz", [-14.0, -5.0, 4.0, 13.0], [-29.0, -19.5], 2.4, -60.0, -30.0)
    clip = softened(box(-23.0, -15.5, 24.0, 28.7, -31.0, -15.0), 0.8)
    return {"print": bracket, "accent": joined([ring, clip]), **servo_of("shoulder")}


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
    pattern = _diamonds(
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
    ring -= _diamonds("xz", [-109.5, -100.0], [4.6, 13.6, 22.6, 31.6], 2.4, 10.0, 40.0)
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


LINKS: dict[str, Callable[[], Solids]] = {
    "base": base,
    "shoulder": shoulder,
    "upper_arm": upper_arm,
    "lower_arm": lower_arm,
    "wrist": wrist,
    "gripper": gripper,
    "jaw": jaw,
}
