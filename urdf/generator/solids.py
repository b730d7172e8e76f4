"""A small vocabulary for printed parts: outlines with rounded corners, prisms, soft edges.

Most parts are the intersection of two or three silhouettes, as on a drawing with three views,
whose edges are then rounded by an opening with a small ball. Lengths in millimetres.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Literal, TypeAlias

import numpy as np
from manifold3d import CrossSection, Manifold, OpType
from numpy.typing import NDArray

Plane: TypeAlias = Literal["xy", "xz", "yz"]
Corner: TypeAlias = tuple[float, float] | tuple[float, float, float]

ARC_STEP = math.radians(24.0)  # chosen: coarse, the shading normals hide the facets
FAR = 300.0  # further than any part reaches

GAP = 36.4  # between the prongs, figure common to every hinge
MIDDLE = GAP / 2
HUB = 12.0  # radius of a prong's end

Solids = dict[str, Manifold]
"""The solids of one link, in its frame, by material."""


def outline(corners: Sequence[Corner], *, radius: float = 0.0) -> CrossSection:
    """Build a polygon whose corners are rounded, the inner ones too.

    Args:
        corners: ``(u, v)`` or ``(u, v, radius)`` in order, either way round.
        radius: Radius of the corners that name none.

    Returns:
        The filled outline. A radius that the neighbouring edges cannot hold is reduced.
    """
    points = np.array([corner[:2] for corner in corners], dtype=np.float64)
    radii = [corner[2] if len(corner) == 3 else radius for corner in corners]
    count = len(points)
    rounded: list[NDArray[np.float64]] = []
    for i in range(count):
        rounded.extend(
            _arc(points[i - 1], points[i], points[(i + 1) % count], radii[i]),
        )
    polygon = np.array(rounded)
    following = np.roll(polygon, -1, axis=0)
    area = np.sum(polygon[:, 0] * following[:, 1] - following[:, 0] * polygon[:, 1])
    return CrossSection([polygon if area > 0 else polygon[::-1]])


def _arc(
    before: NDArray[np.float64],
    corner: NDArray[np.float64],
    after: NDArray[np.float64],
    radius: float,
) -> list[NDArray[np.float64]]:
    """The points that replace one corner."""
    to_before, to_after = before - corner, after - corner
    reach = 0.49 * min(float(np.linalg.norm(to_before)), float(np.linalg.norm(to_after)))
    to_before, to_after = to_before / np.linalg.norm(to_before), to_after / np.linalg.norm(to_after)
    opening = math.acos(float(np.clip(to_before @ to_after, -1.0, 1.0)))
    if radius <= 0.0 or opening > math.pi - 1e-3:
        return [corner]
    tangent = min(radius / math.tan(opening / 2), reach)
    radius = tangent * math.tan(opening / 2)
    middle = to_before + to_after
    centre = corner + middle / np.linalg.norm(middle) * math.hypot(tangent, radius)
    start, end = corner + tangent * to_before - centre, corner + tangent * to_after - centre
    sweep = math.atan2(start[0] * end[1] - start[1] * end[0], start @ end)
    steps = max(1, round(abs(sweep) / ARC_STEP))
    turns = [sweep * k / steps for k in range(steps + 1)]
    return [
        centre
        + np.array(
            [
                start[0] * math.cos(turn) - start[1] * math.sin(turn),
                start[0] * math.sin(turn) + start[1] * math.cos(turn),
            ]
        )
        for turn in turns
    ]


def mirrored(half: Sequence[Corner], *, flip: Literal["u", "v"]) -> list[Corner]:
    """Complete a symmetric outline: the given half, then its image with ``flip`` negated."""
    sign_u, sign_v = (-1.0, 1.0) if flip == "u" else (1.0, -1.0)
    image: list[Corner] = [
        (sign_u * corner[0], sign_v * corner[1], *corner[2:]) for corner in reversed(half)
    ]
    return [*half, *image]


def rectangle(u0: float, u1: float, v0: float, v1: float, radius: float = 0.0) -> CrossSection:
    """Build an axis-aligned rectangle with rounded corners."""
    return outline([(u0, v0), (u1, v0), (u1, v1), (u0, v1)], radius=radius)


def disc(u: float, v: float, radius: float, segments: int = 32) -> CrossSection:
    """Build a filled circle."""
    return CrossSection.circle(radius, segments).translate((u, v))


def diamond(u: float, v: float, half: float) -> CrossSection:
    """Build a square standing on its corner, the arm's hole pattern."""
    return CrossSection([np.array([(u + half, v), (u, v + half), (u - half, v), (u, v - half)])])


def prism(plane: Plane, section: CrossSection, low: float = -FAR, high: float = FAR) -> Manifold:
    """Extrude a section of a plane along the third axis, from ``low`` to ``high``."""
    solid = Manifold.extrude(section, high - low)
    if plane == "xy":
        return solid.translate((0.0, 0.0, low))
    if plane == "xz":  # a quarter turn about x: up becomes -y
        return solid.translate((0.0, 0.0, -high)).rotate((90.0, 0.0, 0.0))
    turn = np.array([[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]])
    return solid.translate((0.0, 0.0, low)).transform(turn)


def views(
    *,
    xy: CrossSection | None = None,
    xz: CrossSection | None = None,
    yz: CrossSection | None = None,
) -> Manifold:
    """Build the largest solid with these silhouettes, seen along z, y and x."""
    sections: list[tuple[Plane, CrossSection | None]] = [("xy", xy), ("xz", xz), ("yz", yz)]
    solids = [prism(plane, section) for plane, section in sections if section is not None]
    return Manifold.batch_boolean(solids, OpType.Intersect)


def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> Manifold:
    """Build an axis-aligned box from its extents."""
    return Manifold.cube((x1 - x0, y1 - y0, z1 - z0)).translate((x0, y0, z0))


def joined(solids: Iterable[Manifold]) -> Manifold:
    """Unite solids."""
    return Manifold.batch_boolean(list(solids), OpType.Add)


def softened(solid: Manifold, radius: float) -> Manifold:
    """Round the outer edges of a solid, leaving its extents alone.

    An opening with a ball (erosion, then dilation); details thinner than ``2 * radius`` vanish,
    so holes are drilled afterwards.
    """
    ball = Manifold.sphere(radius, 8)
    return solid.minkowski_difference(ball).minkowski_sum(ball).simplify(0.02)


def bolt_circle(
    plane: Plane, u: float, v: float, *, circle: float = 7.0, radius: float = 1.6
) -> Manifold:
    """Build the drills for a horn: four screws round a shaft, and the shaft's own screw."""
    holes = [disc(u, v, 3.4, 14)]
    holes += [
        disc(u + circle * math.cos(turn), v + circle * math.sin(turn), radius, 10)
        for turn in np.radians([45.0, 135.0, 225.0, 315.0])
    ]
    return joined(prism(plane, hole) for hole in holes)


def diamonds(
    plane: Plane, us: list[float], vs: list[float], half: float, low: float, high: float
) -> Manifold:
    """Build the arm's hole pattern: a grid of diamonds."""
    return joined(prism(plane, diamond(u, v, half), low, high) for u in us for v in vs)


def placed(
    solid: Manifold, xyz: tuple[float, float, float], rpy: tuple[float, float, float]
) -> Manifold:
    """Move a solid to a pose given as in a URDF: roll, pitch, yaw about fixed axes, [rad]."""
    return solid.rotate(tuple(math.degrees(angle) for angle in rpy)).translate(xyz)
