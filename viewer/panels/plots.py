"""Plots of a plan against its limits, and of the tracking error of a run."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg
from so101_motion.planning.request import Plan
from so101_motion.planning.timing.trajectory import Trajectory

from ..page import markup, texts
from ..page.bar import uuid_of
from ..page.screen_state import PlanView
from ..page.tracking import Tracking

_COLORS = ("#e03131", "#2f9e44", "#1c7ed6", "#f08c00", "#9c36b5")
_GRAY = "#868e96"
_HEIGHT = 150
NO_PLAN = "No plan yet."
_MOST_POINTS = 400
"""Chosen: more samples than the plot has pixels would be wasted."""

_LEAST_ERROR_DEG = 0.1
"""The plot of the tracking error shows at least this much to either side [deg]; chosen: else the
noise of a perfect motion would fill it."""


class PlanPlots:
    """Four tabs of plots, empty until there is a plan."""

    def __init__(self, gui: viser.GuiApi, panel: viser.PanelHandle) -> None:
        self._captions: list[viser.GuiHtmlHandle] = []
        with panel.add_tab("Velocity"):
            self._caption(gui)
            self._velocity = add_velocity_plot(gui)
        with panel.add_tab("Acceleration"):
            self._caption(gui)
            self._acceleration = _add_plot(gui, "acceleration (°/s²)", ("limit", "−limit"))
        with panel.add_tab("Position"):
            self._caption(gui)
            self._position = _add_plot(gui, "position (°)", ("nearest limit",))
        with panel.add_tab("Tracking"):
            self._facts = gui.add_html(markup.small("After a motion: measured minus planned."))
            ends = (f"+{_LEAST_ERROR_DEG:g}°", f"−{_LEAST_ERROR_DEG:g}°")
            self._error = _add_plot(gui, "error (°)", ends, height=_HEIGHT - 25)

    def _caption(self, gui: viser.GuiApi) -> None:
        self._captions.append(gui.add_html(markup.small(NO_PLAN)))

    @property
    def uuids(self) -> list[str]:
        """The ids of the plots over the time of a plan."""
        over_time = (self._velocity, self._acceleration, self._position)
        return [uuid_of(plot) or "" for plot in over_time]

    def name(self, view: PlanView | None, *, is_current: bool) -> None:
        """Say which plan it is, and whether it is old."""
        if view is not None:
            content = markup.caption(texts.plotted(view, is_current=is_current), not is_current)
            for caption in self._captions:
                caption.content = content

    def show(self, plan: Plan, bounds: tuple[Array, Array]) -> None:
        """Draw ``plan``.

        Args:
            plan: The plan.
            bounds: The smallest and the largest joint angles, shapes (5,), [rad].
        """
        trajectory, limits = plan.trajectory, plan.limits
        keep = _kept(trajectory)
        t = trajectory.t[keep]
        push = float(np.max(limits.acceleration))
        q = trajectory.q[keep]
        show_velocity(self._velocity, plan)
        self._acceleration.data = _columns(t, trajectory.qdd[keep], push, -push)
        self._position.data = _columns(t, q, nearest_limit(q, bounds))

    def show_tracking(self, tracking: Tracking, name: str) -> None:
        """Plot the tracking error of the motion ``name``, and show it in figures."""
        keep = np.unique(np.linspace(0, len(tracking.t) - 1, _MOST_POINTS).astype(int))
        most = np.radians(_LEAST_ERROR_DEG)
        self._error.data = _columns(tracking.t[keep], tracking.error[keep], most, -most)
        said = f"{name}: {texts.followed(tracking)}"
        self._facts.content = markup.small(said[0].upper() + said[1:])


def add_velocity_plot(gui: viser.GuiApi) -> viser.GuiUplotHandle:
    """Add a plot of how fast the joints turn."""
    return _add_plot(gui, "velocity (°/s)", ("limit", "−limit"))


def show_velocity(plot: viser.GuiUplotHandle, plan: Plan) -> None:
    """Draw in ``plot`` how fast the joints turn."""
    keep, speed = _kept(plan.trajectory), float(np.max(plan.limits.velocity))
    plot.data = _columns(plan.trajectory.t[keep], plan.trajectory.qd[keep], speed, -speed)


def _kept(trajectory: Trajectory) -> NDArray[np.intp]:
    """The samples that are drawn."""
    return np.unique(np.linspace(0, len(trajectory) - 1, _MOST_POINTS).astype(np.intp))


def nearest_limit(q: Array, bounds: tuple[Array, Array]) -> float:
    """The joint limit that a motion comes nearest to [rad].

    Args:
        q: Joint angles along the path, shape (n, 5), [rad].
        bounds: The smallest and the largest joint angles, shapes (5,), [rad].
    """
    limits = np.concatenate(bounds)
    room = np.concatenate([q.min(axis=0) - bounds[0], bounds[1] - q.max(axis=0)])
    return float(limits[int(np.argmin(room))])


def _columns(t: Array, values: Array, *lines: float) -> tuple[Array, ...]:
    """Time, one column a joint, and level lines; in degrees."""
    level = tuple(np.full(len(t), to_deg(line)) for line in lines)
    return (t, *to_deg(values).T.copy(), *level)


def _add_plot(
    gui: viser.GuiApi, label: str, lines: tuple[str, ...], *, height: int = _HEIGHT
) -> viser.GuiUplotHandle:
    still = np.zeros((2, len(ARM_JOINTS)))
    data = _columns(np.array([0.0, 1.0]), still, *(0.1 * (-1) ** k for k in range(len(lines))))
    return add_plot(gui, label, ARM_JOINTS, lines, data, height=height)


def add_plot(
    gui: viser.GuiApi,
    label: str,
    curves: Sequence[str],
    lines: Sequence[str],
    data: tuple[Array, ...],
    *,
    height: int = _HEIGHT,
) -> viser.GuiUplotHandle:
    """Add a plot over the time of a plan.

    Args:
        gui: Where.
        label: What is drawn, with its unit.
        curves: What each curve is called.
        lines: What each level line is called.
        data: Times, the values of each curve, and of each line.
        height: [px].
    """
    colors = cycle(_COLORS)
    drawn = tuple(
        uplot.Series(label=name, stroke=next(colors), width=2, points={"show": False})
        for name in curves
    )
    level = tuple(
        uplot.Series(label=line, stroke=_GRAY, width=1, dash=(6, 4), points={"show": False})
        for line in lines
    )
    axis = uplot.Axis(stroke=_GRAY, labelSize=18, size=34)
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
