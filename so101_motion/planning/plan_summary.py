"""A plan in words and as a small picture, for a prompt or a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import in_mm, to_mm

if TYPE_CHECKING:
    from so101_motion.planning.request import Plan

_WIDE, _HIGH, _PER_PIXEL = 220, 150, 4.0  # of one view [pixel], and millimetres in one; chosen


def tool_length(plan: Plan) -> float:
    """How far the tool travels [m]."""
    return float(np.sum(np.linalg.norm(np.diff(plan.tool_path, axis=0), axis=1)))


def in_words(plan: Plan) -> str:
    """Five lines: duration, length, clearance, share of the caps, from where to where."""
    trajectory, limits, report = plan.trajectory, plan.limits, plan.report
    used = [_used("speed", trajectory.qd, limits.velocity)]
    used.append(_used("acceleration", trajectory.qdd, limits.acceleration))
    if report.effort:
        used.append(f"torque {report.effort:.0%}")
    if report.short_of_drive:
        used.append(report.short_of_drive)
    return "\n".join(
        (
            f"duration   {plan.duration:.2f} s",
            f"length     {to_mm(tool_length(plan)):.0f} mm of the tool",
            f"clearance  {to_mm(report.clearance):.0f} mm at the goal, between"
            f" {' and '.join(report.closest)}",
            f"caps       {', '.join(used)}",
            f"tool       from {in_mm(plan.tool_path[0])} to {in_mm(plan.tool_path[-1])}",
        )
    )


def _used(what: str, rates: Array, caps: Array) -> str:
    shares = np.max(np.abs(rates), axis=0) / caps
    return f"{what} {shares.max():.0%} ({ARM_JOINTS[int(shares.argmax())]})"


def as_html(plan: Plan) -> str:
    """The words, beside the tool's path seen from above and from the side, as SVG."""
    x, y, z = to_mm(plan.tool_path).T / _PER_PIXEL
    above = _view("from above", 0.5 * _WIDE - y, 0.8 * _HIGH - x, 0.5 * _WIDE)
    side = _view("from the side", 0.2 * _WIDE + np.hypot(x, y), 0.8 * _HIGH - z, 0.2 * _WIDE)
    return f"<pre>{in_words(plan)}</pre>{above}{side}"


def _view(title: str, u: Array, v: Array, u_base: float) -> str:
    """One view; the dark square is the base, the dot the goal."""
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(u, v, strict=True))
    return (
        f'<svg width="{_WIDE}" height="{_HIGH}" role="img" aria-label="tool path {title}"'
        ' style="background:#f4f4f4;margin-right:8px">'
        f'<text x="6" y="14" font-size="11" fill="#444">{title}</text>'
        f'<rect x="{u_base - 4:.0f}" y="{0.8 * _HIGH - 4:.0f}" width="8" height="8" fill="#444"/>'
        f'<polyline points="{points}" fill="none" stroke="#0a6cbd" stroke-width="2"/>'
        f'<circle cx="{u[-1]:.1f}" cy="{v[-1]:.1f}" r="4" fill="#0a6cbd"/></svg>'
    )
