"""Lay out a plan as a table for the terminal."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import numpy as np

from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_mm

if TYPE_CHECKING:
    from so101_motion.planning.request import Plan


_NUMBERS, _SPARKS = 40, 40  # columns; chosen: together the width of a usual terminal


def plan_table(plan: Plan) -> str:
    """A plan as a table for the terminal: travel, peak speed and speed over time per joint."""
    trajectory = plan.trajectory
    travel_deg = to_deg(trajectory.q[-1] - trajectory.q[0])
    peak_deg = to_deg(np.max(np.abs(trajectory.qd), axis=0))
    tool_mm = float(to_mm(np.sum(np.linalg.norm(np.diff(plan.tool_path, axis=0), axis=1))))
    width = min(shutil.get_terminal_size().columns - _NUMBERS, _SPARKS)
    planned_ms = plan.report.stages_ms["total"]
    lines = [
        f"{plan.duration:.2f} s, {len(trajectory)} setpoints {1e3 * trajectory.dt:g} ms apart, "
        f"tool path {tool_mm:.0f} mm, planned in {planned_ms:.1f} ms"
        + (" (the time was up, a quicker route may exist)" if plan.report.out_of_time else ""),
        "",
        f"{'joint':<14}{'travel':>10}{'peak speed':>13}   speed over time"[
            : _NUMBERS + max(width, 0)
        ],
    ]
    for i, joint in enumerate(ARM_JOINTS):
        lines.append(
            f"{joint:<14}{travel_deg[i]:>6.1f} deg{peak_deg[i]:>7.1f} deg/s   "
            + _sparkline(np.abs(trajectory.qd[:, i]), float(np.max(plan.limits.velocity)), width)
        )
    return "\n".join(line.rstrip() for line in lines)


def _sparkline(values: np.ndarray, top: float, width: int) -> str:
    if width < 1:
        return ""
    bars = " ▁▂▃▄▅▆▇█"
    columns = [float(np.max(part)) for part in np.array_split(values, min(width, len(values)))]
    return "".join(bars[round(min(value / top, 1.0) * (len(bars) - 1))] for value in columns)
