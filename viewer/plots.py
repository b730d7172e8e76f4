"""A plan's speeds and accelerations over time, against the caps they had to keep."""

from __future__ import annotations

import numpy as np
import viser
from viser import uplot

from so101_motion.geometry import Array
from so101_motion.planning.plan import Plan
from so101_motion.state import ARM_JOINTS
from so101_motion.units import to_deg

_COLORS = ("#e03131", "#2f9e44", "#1c7ed6", "#f08c00", "#9c36b5")
_GRAY = "#868e96"
_HEIGHT = 165
_MOST_POINTS = 600
"""More samples than the plot has pixels would be wasted on the wire."""


class PlanPlots:
    """Two tabs of a panel, empty until the first plan.

    Args:
        gui: Where to make them.
        panel: The panel they live in.
    """

    def __init__(self, gui: viser.GuiApi, panel: viser.PanelHandle) -> None:
        with panel.add_tab("Velocity"):
            self._velocity = _add_plot(gui, "velocity (°/s)")
        with panel.add_tab("Acceleration"):
            self._acceleration = _add_plot(gui, "acceleration (°/s²)")

    def show(self, plan: Plan) -> None:
        """Draw ``plan``."""
        trajectory, limits = plan.trajectory, plan.limits
        keep = np.unique(np.linspace(0, len(trajectory) - 1, _MOST_POINTS).astype(int))
        t = trajectory.t[keep]
        self._velocity.data = _columns(t, trajectory.qd[keep], limits.velocity)
        self._acceleration.data = _columns(t, trajectory.qdd[keep], limits.acceleration)


def _columns(t: Array, values: Array, caps: Array) -> tuple[Array, ...]:
    """Time, one column a joint, and the largest joint's cap on both sides; in degrees."""
    cap = np.full(len(t), to_deg(float(np.max(caps))))
    return (t, *to_deg(values).T.copy(), cap, -cap)


def _add_plot(gui: viser.GuiApi, label: str) -> viser.GuiUplotHandle:
    joints = tuple(
        uplot.Series(label=joint, stroke=color, width=2, points={"show": False})
        for joint, color in zip(ARM_JOINTS, _COLORS, strict=True)
    )
    cap = uplot.Series(label="cap", stroke=_GRAY, width=1, dash=(6, 4), points={"show": False})
    axis = uplot.Axis(stroke=_GRAY, labelSize=18, size=34)
    empty = _columns(np.array([0.0, 1.0]), np.zeros((2, len(ARM_JOINTS))), np.ones(1))
    return gui.add_uplot(
        empty,
        (uplot.Series(label="time (s)"), *joints, cap, uplot.Series(**{**cap, "label": "−cap"})),
        scales={"x": uplot.Scale(time=False)},
        axes=(
            uplot.Axis(**{**axis, "label": "time (s)"}),
            uplot.Axis(**{**axis, "label": label, "size": 46, "space": 18}),
        ),
        legend=uplot.Legend(show=True, live=False),
        height=_HEIGHT,
        padding=(10, 16, 0, 0),
    )
