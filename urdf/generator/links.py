"""The seven links as solids, drawn by us from the arm's dimensions and cut to their hulls.

The figures (extents, axes, gaps, where a servo sits) are those of TheRobotStudio's SO-101; the
shapes between them are ours: plainer, with our own rounding. Each function gives the solids of
one link in that link's frame, keyed by material, in millimetres:

``print``   the main colour
``accent``  motor holders and the moving jaw, printed in a second colour
``servo``   the black case
``horn``    the discs on the servo's shaft and their screws

A rule that shapes most of the parts: between the two prongs that hold a horn there are always
36.4 mm, and a prong ends in a half disc of 12 mm round the axis.

Corners that would stand out of the link's collision hull, and so out of the real part, are cut off,
so the collision hull contains all that is drawn.
"""

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from manifold3d import Manifold

from .. import load_hull
from .arm_links import lower_arm, upper_arm, wrist
from .base_links import base, shoulder
from .hand_links import gripper, jaw
from .solids import Solids

_DRAWN: Final[dict[str, Callable[[], Solids]]] = {
    "base": base,
    "shoulder": shoulder,
    "upper_arm": upper_arm,
    "lower_arm": lower_arm,
    "wrist": wrist,
    "gripper": gripper,
    "jaw": jaw,
}

_INSIDE: Final = 0.001
"""Least distance of the drawn solid to the hull [mm], because files hold rounded numbers.
Chosen."""


def _cut(part: str) -> Solids:
    vertices = load_hull(part).vertices * 1e3
    middle = vertices.mean(axis=0)
    away = vertices - middle
    shrunk = middle + away * (1.0 - _INSIDE / np.linalg.norm(away, axis=1).min())
    hull = Manifold.hull_points(shrunk)
    return {material: solid ^ hull for material, solid in _DRAWN[part]().items()}


LINKS: Final = {part: partial(_cut, part) for part in _DRAWN}
