"""The units in which fields show values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from so101_motion.common.units import to_deg, to_m, to_mm, to_rad


class Unit(NamedTuple):
    """How a widget shows a value, and which value a person means by what is entered."""

    shown: Callable[[Any], Any] = lambda value: value
    meant: Callable[[Any], Any] = lambda entered: entered


def _tenths(value: Any) -> float | tuple[float, ...]:
    rounded = np.round(value, 1) + 0.0  # never -0
    return tuple(map(float, rounded)) if np.ndim(rounded) else float(rounded)


PLAIN = Unit()
TENTHS, HUNDREDTHS = Unit(_tenths), Unit(lambda value: round(value, 2))
DEGREES = Unit(lambda angle: _tenths(to_deg(angle)), lambda deg: to_rad(_array(deg)))
WHOLE_DEGREES = Unit(lambda angle: round(to_deg(angle)), to_rad)
MM = Unit(lambda length: _tenths(to_mm(length)), lambda mm: to_m(_array(mm)))
GRAMS = Unit(lambda mass: _tenths(1000.0 * mass), lambda grams: grams / 1000.0)
PERCENT = Unit(lambda share: round(100.0 * share), lambda percent: percent / 100.0)


def _array(entered: Any) -> Any:
    return np.array(entered) if isinstance(entered, tuple) else entered
