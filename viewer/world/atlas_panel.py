"""The Atlas tab: coloured cubes where the arm reaches; a click on one makes its pose the goal.

Only the outer cubes are sent. A click moves nothing but the goal's ghost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import viser

from so101_motion.common.geometry import Array
from so101_motion.common.units import to_m, to_mm
from so101_motion.planning.collision.scene import Box
from so101_motion.tasks.sweeps.atlas import Atlas
from so101_motion.tasks.sweeps.atlas_view import (
    AXES,
    FIGURES,
    Shown,
    Voxels,
    in_words,
    voxels,
)

from ..page import markup
from ..page.page_context import PageContext, Part
from ..scene.scene_view import surface

_ALL = "All"
_SHARE = 0.8  # of the spacing: gaps show what is inside


class AtlasPart(Part):
    """The tab of an atlas; ``set_goal`` takes joint angles, shape (5,), [rad]."""

    def __init__(
        self, context: PageContext, atlas: Atlas, set_goal: Callable[[Array], None]
    ) -> None:
        self._atlas, self._set_goal = atlas, set_goal
        self._scene, self._context = context.server.scene, context
        self._shown, self._is_new = Shown(axis="y"), True  # the whole atlas would hide the arm
        self._cubes: viser.BatchedMeshHandle | None = None
        self._seen: Voxels | None = None
        gui = context.gui
        low, high = (to_mm(end) for end in _ends(atlas))
        with context.tabs.add_tab("Atlas", viser.Icon.CHART_DOTS_3):
            figure = gui.add_dropdown("Colour by", tuple(FIGURES))
            self._least = gui.add_slider("At least (%)", 0.0, 100.0, 1.0, 0.0)
            slices = (_ALL, *(f"at one {each}" for each in AXES))
            axis = gui.add_dropdown("Slice", slices, initial_value="at one y")
            at = gui.add_slider("Slice at (mm)", low, high, to_mm(atlas.grid.spacing), 0.0)
            visible = gui.add_checkbox("Show", True)
            self._words = gui.add_html("")
        context.on_entry(figure, self._set_figure)
        context.on_entry(self._least, self._set_least)
        context.on_entry(axis, lambda at: self._set(axis=None if at == _ALL else at[-1]))
        context.on_entry(at, lambda value: self._set(at=to_m(float(value))))
        context.on_entry(visible, self._set_visible)

    def _set(self, **changed: Any) -> None:
        self._shown, self._is_new = replace(self._shown, **changed), True

    def _set_figure(self, name: str) -> None:
        self._set(figure=name)
        self._set_least(float(self._least.value))

    def _set_least(self, percent: float) -> None:
        of = FIGURES[self._shown.figure]
        self._set(at_least=of.low + 0.01 * float(percent) * (of.high - of.low))

    def _set_visible(self, visible: bool) -> None:
        if self._cubes is not None:
            self._cubes.visible = visible

    def refresh(self) -> bool:
        return self._is_new

    def show(self) -> None:
        if not self._is_new:
            return
        self._is_new = False
        self._seen = seen = voxels(self._atlas, self._shown)
        was_visible = True
        if self._cubes is not None:
            was_visible = self._cubes.visible
            self._cubes.remove()
            self._cubes = None
        if len(seen.rows) == 0:
            self._words.content = markup.small("Nothing to show; ask for less.")
            return
        cube = surface(Box(size=np.full(3, _SHARE * self._atlas.grid.spacing)))
        self._cubes = self._scene.add_batched_meshes_simple(
            "/atlas", *cube, np.tile((1.0, 0.0, 0.0, 0.0), (len(seen.rows), 1)),
            seen.p, batched_colors=seen.colours, flat_shading=True, lod="off", cast_shadow=False,
            receive_shadow=False, visible=was_visible,
        )  # fmt: skip
        self._cubes.on_click(
            self._context.handler(lambda event: partial(self._take, event.instance_index))
        )
        self._words.content = markup.small(
            f"{seen.total} points of {len(self._atlas.points)}. Click a cube: its pose becomes the"
            " goal."
        )

    def _take(self, number: int | None) -> None:
        if self._seen is None or number is None or not 0 <= number < len(self._seen.rows):
            return  # the cubes are others by now
        x, y, z = self._seen.p[number].tolist()
        reach = self._atlas.at(x, y, z)
        self._words.content = markup.small(in_words(reach, self._seen.p[number]))
        self._set_goal(np.array(reach.q))


def _ends(atlas: Atlas) -> tuple[float, float]:
    """The furthest points of the grid along any axis [m]."""
    first, counts = np.array(atlas.grid.first), np.array(atlas.grid.counts)
    spacing = atlas.grid.spacing
    return float(first.min()) * spacing, float((first + counts - 1).max()) * spacing
