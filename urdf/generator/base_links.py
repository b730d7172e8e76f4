"""The two links that stand on the table: base and shoulder."""

from .servo import servo_of
from .solids import (
    GAP,
    Solids,
    bolt_circle,
    box,
    diamond,
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
    ring -= diamonds("yz", [-14.0, -5.0, 4.0, 13.0], [-29.0, -19.5], 2.4, -60.0, -30.0)
    clip = softened(box(-23.0, -15.5, 24.0, 28.7, -31.0, -15.0), 0.8)
    return {"print": bracket, "accent": joined([ring, clip]), **servo_of("shoulder")}
