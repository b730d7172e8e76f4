"""Measure the distance between two points that are clicked in the picture."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser

from so101_motion.common.geometry import Array
from so101_motion.common.units import to_mm

_ROOT = "/measure"
_COLOR = (214, 51, 108)


def distance_text(a: Array, b: Array) -> str:
    """The distance of two points, shape (3,), [m], and its parts along the base's axes."""
    x, y, z = (abs(each) for each in to_mm(b - a))
    far = to_mm(float(np.linalg.norm(b - a)))
    return f"{far:.0f} mm (X {x:.0f}, Y {y:.0f}, Z {z:.0f})"


class Measuring:
    """A line between the last two points that were clicked; a third begins anew."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._points: list[Array] = []
        self._nodes: list[Any] = []

    def take(self, p: Array) -> str:
        """Take a point, shape (3,), [m]; returns the distance, or what to click next."""
        if len(self._points) == 2:
            self.clear()
        self._points.append(p)
        name = f"{_ROOT}/{len(self._points)}"
        self._nodes.append(
            self._scene.add_icosphere(name, 0.004, color=_COLOR, position=p, cast_shadow=False)
        )
        if len(self._points) < 2:
            return "Click the second point."
        a, b = self._points
        self._nodes += [
            self._scene.add_line_segments(
                f"{_ROOT}/line", np.array([[a, b]]), _COLOR, thickness=3.0, thickness_units="screen"
            ),
            self._scene.add_label(
                f"{_ROOT}/text", distance_text(a, b), position=0.5 * (a + b) + [0.0, 0.0, 0.02]
            ),
        ]
        return f"{distance_text(a, b)}."

    def clear(self) -> None:
        """Remove the line."""
        for node in self._nodes:
            node.remove()
        self._nodes, self._points = [], []
