"""Convert millimetres and degrees to SI units and back, at the edges only.

Everything inside is in metres, radians and seconds. The code that talks to people or to Viam
converts once, with these functions; they take floats and arrays alike.
"""

import math
from typing import TypeVar

import numpy as np

FloatOrArray = TypeVar("FloatOrArray", float, np.ndarray)

_DEG = math.pi / 180.0


def to_rad(angle_deg: FloatOrArray) -> FloatOrArray:
    return angle_deg * _DEG


def to_deg(angle: FloatOrArray) -> FloatOrArray:
    return angle / _DEG


def to_m(length_mm: FloatOrArray) -> FloatOrArray:
    return length_mm / 1000.0


def to_mm(length: FloatOrArray) -> FloatOrArray:
    return length * 1000.0


def in_mm(p: np.ndarray) -> str:
    """A point [m] in words."""
    return f"({', '.join(f'{x:.1f}' for x in to_mm(p).round(1) + 0.0)}) mm"


def angles_deg(q: np.ndarray) -> str:
    """Angles [rad] in words."""
    return f"({', '.join(f'{x:.1f}' for x in to_deg(q).round(1) + 0.0)}) deg"


def range_deg(lower: float, upper: float, digits: int = 2) -> str:
    """A range of angles [rad] in degrees, rounded inwards: both ends that are shown can be reached.

    A bound that is within 1e-9 deg of a rounded number is that number.
    """
    scale = 10.0**digits
    least = math.ceil(scale * to_deg(lower) - 1e-9) / scale if lower > -math.inf else lower
    most = math.floor(scale * to_deg(upper) + 1e-9) / scale if upper < math.inf else upper
    return f"{least:.{digits}f} to {most:.{digits}f}"
