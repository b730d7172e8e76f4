"""Plots of a plan: joints against limits, clearance between arms; of a run its tracking error."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, cycle

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_mm
from so101_motion.planning.collision.apart import ROOM
from so101_motion.planning.request import Plan

from ..page import markup, texts
from ..page.bar import uuid_of
from ..page.plan_view import CommonPlan, PlanView
from ..page.tracking import Tracking
from ..view_model import MoveModel

_COLORS = ("#e03131", "#2f9e44", "#1c7ed6", "#f08c00", "#9c36b5")
_GRAY = "#868e96"
_HEIGHT = 150
_NO_PLAN = "No plan yet."
_SIZE = (390, 305)  # between the panels of the narrowest window that has both
_MARGIN = 12
_MOST_POINTS = 400  # chosen: more samples than the plot has pixels would be wasted

_LEAST_ERROR_DEG = 0.1
"""The plot of the tracking error shows at least this much to either side [deg]; chosen: else the
noise of a perfect motion would fill it."""


class PlanPlots:
    """The panel with the plots of the newest plan; small, and empty, until there is one.

    A single arm has plots of velocity, acceleration, position and tracking. Of several there are
    the clearance between every two, and the velocity of each.
    """

    def __init__(self, gui: viser.GuiApi, names: Sequence[str]) -> None:
        self._gui, self._panel = gui, gui.add_panel(order=0.0)  # the first one in a small window
        width, height = _SIZE
        self._panel.float(x=_MARGIN, y=-_MARGIN, width=width, height=height)
        self._panel.minimize()
        self._captions: dict[str, list[viser.GuiHtmlHandle]] = {name: [] for name in names}
        self._shown: dict[str, PlanView] = {}
        self._tracking: Tracking | None = None
        self._plots: list[viser.GuiUplotHandle] = []  # over the time of a plan
        self._common: CommonPlan | None = None
        several = len(names) > 1
        self._only = None if several else names[0]
        if several:
            self._add_clearance([f"{a} to {b}" for a, b in combinations(names, 2)])
        ends = ("limit", "−limit")
        self._velocity = {
            name: self._add(name, name if several else "Velocity", "velocity (°/s)", *ends)
            for name in names
        }
        if self._only is not None:
            self._acceleration = self._add(self._only, "Acceleration", "acceleration (°/s²)", *ends)
            self._position = self._add(self._only, "Position", "position (°)", "nearest limit")
            self._add_tracking()

    def _add(self, arm: str, title: str, label: str, *lines: str) -> viser.GuiUplotHandle:
        with self._panel.add_tab(title):
            self._captions[arm].append(self._gui.add_html(markup.small(_NO_PLAN)))
            self._plots.append(_add_joints_plot(self._gui, label, lines))
        return self._plots[-1]

    def _add_clearance(self, pairs: Sequence[str]) -> None:
        none = np.zeros((1 + len(pairs), 2))
        none[0, 1] = 1.0
        with self._panel.add_tab("Clearance"):
            self._caption = self._gui.add_html(markup.small(_NO_PLAN))
            self._clearance = _add_plot(
                self._gui, "clearance (mm)", pairs, ("least allowed",), (*none, _least(2))
            )
        self._plots.append(self._clearance)

    def _add_tracking(self) -> None:
        with self._panel.add_tab("Tracking"):
            self._facts = self._gui.add_html(
                markup.small("After a motion: measured minus planned.")
            )
            ends = (f"+{_LEAST_ERROR_DEG:g}°", f"−{_LEAST_ERROR_DEG:g}°")
            self._error = _add_joints_plot(self._gui, "error (°)", ends, height=_HEIGHT - 25)

    @property
    def uuids(self) -> list[str]:
        return [uuid_of(plot) or "" for plot in self._plots]

    def show(self, model: MoveModel) -> None:
        for name, arm in model.arms.items():
            view = arm.plan_view
            if view is not None:
                if not self._shown:
                    self._panel.expand()
                if view is not self._shown.get(name):
                    self._shown[name] = view
                    self._draw(name, view.plan, arm.arm.range)
                said = texts.plotted(view, is_current=arm.plan_is_current)
                for caption in self._captions[name]:
                    caption.content = markup.caption(said, not arm.plan_is_current)
            tracking = arm.tracker.newest
            if name == self._only and tracking is not None and tracking is not self._tracking:
                self._tracking = tracking
                self._show_tracking(tracking, arm.tracker.newest_name)
        if self._only is None and model.common_plan is not None:
            self._show_clearance(model.common_plan, is_current=model.plan_is_current)

    def _draw(self, name: str, plan: Plan, bounds: tuple[Array, Array]) -> None:
        trajectory, limits = plan.trajectory, plan.limits
        keep = _kept(len(trajectory))
        t, q = trajectory.t[keep], trajectory.q[keep]
        speed, push = float(np.max(limits.velocity)), float(np.max(limits.acceleration))
        self._velocity[name].data = _columns(t, trajectory.qd[keep], speed, -speed)
        if name == self._only:
            self._acceleration.data = _columns(t, trajectory.qdd[keep], push, -push)
            self._position.data = _columns(t, q, nearest_limit(q, bounds))

    def _show_clearance(self, plan: CommonPlan, *, is_current: bool) -> None:
        said = texts.common_plotted(plan.name, plan.duration, is_current=is_current)
        self._caption.content = markup.caption(said, not is_current)
        if plan is not self._common:
            self._common = plan
            t = np.array([each.t for each in plan.clearances[0].closest])
            gaps = [
                to_mm(np.array([each.distance for each in between.closest]))
                for between in plan.clearances
            ]
            self._clearance.data = (t, *gaps, _least(len(t)))

    def _show_tracking(self, tracking: Tracking, name: str) -> None:
        keep, most = _kept(len(tracking.t)), np.radians(_LEAST_ERROR_DEG)
        self._error.data = _columns(tracking.t[keep], tracking.error[keep], most, -most)
        said = f"{name}: {texts.followed(tracking)}"
        self._facts.content = markup.small(said[0].upper() + said[1:])


def _least(count: int) -> Array:
    """The least clearance between two arms [mm], ``count`` times."""
    return np.full(count, to_mm(ROOM))


def _kept(count: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, count - 1, _MOST_POINTS).astype(np.intp))


def nearest_limit(q: Array, bounds: tuple[Array, Array]) -> float:
    """The joint limit [rad] that a motion along ``q``, shape (n, 5), [rad], comes nearest to."""
    limits = np.concatenate(bounds)
    room = np.concatenate([q.min(axis=0) - bounds[0], bounds[1] - q.max(axis=0)])
    return float(limits[int(np.argmin(room))])


def _columns(t: Array, values: Array, *lines: float) -> tuple[Array, ...]:
    """Time, one column a joint, and level lines; in degrees."""
    level = tuple(np.full(len(t), to_deg(line)) for line in lines)
    return (t, *to_deg(values).T.copy(), *level)


def _add_joints_plot(
    gui: viser.GuiApi, label: str, lines: tuple[str, ...], *, height: int = _HEIGHT
) -> viser.GuiUplotHandle:
    still = np.zeros((2, len(ARM_JOINTS)))
    data = _columns(np.array([0.0, 1.0]), still, *(0.1 * (-1) ** k for k in range(len(lines))))
    return _add_plot(gui, label, ARM_JOINTS, lines, data, height=height)


def _add_plot(
    gui: viser.GuiApi,
    label: str,
    curves: Sequence[str],
    lines: Sequence[str],
    data: tuple[Array, ...],
    *,
    height: int = _HEIGHT,
) -> viser.GuiUplotHandle:
    colors = cycle(_COLORS)
    drawn = tuple(
        uplot.Series(label=name, stroke=next(colors), width=2, points={"show": False})
        for name in curves
    )
    level = tuple(
        uplot.Series(label=line, stroke=_GRAY, width=1, dash=(6, 4), points={"show": False})
        for line in lines
    )
    axis = uplot.Axis(labelSize=18, size=34)
    return gui.add_uplot(
        data,
        (uplot.Series(label="time (s)"), *drawn, *level),
        scales={"x": uplot.Scale(time=False)},
        axes=(
            uplot.Axis(**{**axis, "label": "time (s)"}),
            uplot.Axis(**{**axis, "label": label, "size": 46, "space": 18}),
        ),
        legend=uplot.Legend(show=True, live=False),
        height=height,
        padding=(10, 16, 0, 0),
    )
