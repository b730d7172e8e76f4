"""Plots of a common plan: the clearance between every two arms, and the joints of each arm."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import viser

from so101_motion.common.units import to_mm
from so101_motion.planning.collision.apart import ROOM

from ..cell_model import CommonPlan
from ..page import markup, texts
from ..page.bar import uuid_of
from .plots import NO_PLAN, add_plot, add_velocity_plot, show_velocity

_NONE = np.array([0.0, 1.0])


class CellPlots:
    """A tab with the clearance, and one for each arm; empty until there is a plan.

    Args:
        names: What the arms are called.
    """

    def __init__(self, gui: viser.GuiApi, panel: viser.PanelHandle, names: Sequence[str]) -> None:
        self._pairs = [f"{a} to {b}" for a, b in combinations(names, 2)]
        with panel.add_tab("Clearance"):
            self._caption = gui.add_html(markup.small(NO_PLAN))
            self._clearance = add_plot(
                gui,
                "clearance (mm)",
                self._pairs,
                ("least allowed",),
                (_NONE, *(0.0 * _NONE for _ in self._pairs), 0.0 * _NONE + to_mm(ROOM)),
            )
        self._velocities: dict[str, viser.GuiUplotHandle] = {}
        for name in names:
            with panel.add_tab(name):
                gui.add_html(markup.small(f"How fast the joints of {name} turn."))
                self._velocities[name] = add_velocity_plot(gui)

    @property
    def uuids(self) -> list[str]:
        """The ids of the plots."""
        return [uuid_of(each) or "" for each in (self._clearance, *self._velocities.values())]

    def name(self, plan: CommonPlan | None, *, is_current: bool) -> None:
        """Say which plan it is, and whether it is old."""
        if plan is not None:
            said = texts.common_plotted(plan.name, plan.duration, is_current=is_current)
            self._caption.content = markup.caption(said, not is_current)

    def show(self, plan: CommonPlan) -> None:
        """Draw ``plan``."""
        if plan.clearances:
            t = np.array([each.t for each in plan.clearances[0].closest])
            gaps = [
                to_mm(np.array([each.distance for each in between.closest]))
                for between in plan.clearances
            ]
            self._clearance.data = (t, *gaps, np.full(len(t), to_mm(ROOM)))
        for name, part in plan.plans.items():
            show_velocity(self._velocities[name], part)
