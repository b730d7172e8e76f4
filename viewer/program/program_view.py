"""Draw a program: numbered dots at the waypoints and the planned path through them.

Dots carry numbers, not names: typed text never becomes part of the scene.
"""

from __future__ import annotations

import numpy as np
import viser

from so101_motion.common.geometry import Array
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.request import Plan
from so101_motion.tasks.program import Program, Rehearsal

from ..scene.robot_view import segments

_COLOR = (147, 51, 234)
_ROOT = "/program"
_ABOVE = np.array([0.0, 0.0, 0.015])

_POINTS = 32
"""Points of the tool path that are drawn for each waypoint; chosen."""


class ProgramView:
    """Draws a program and its plan.

    Args:
        model: Kinematics; used by the thread that calls ``show`` alone.
    """

    def __init__(self, scene: viser.SceneApi, model: RobotModel) -> None:
        self._scene, self._model = scene, model
        self._program: Program | None = None
        self._rehearsal: Rehearsal | None = None
        self._dots: list[viser.SceneNodeHandle] = []
        self._path: viser.LineSegmentsHandle | None = None

    def show(self, program: Program, rehearsal: Rehearsal | None) -> None:
        """Draw program and plan; sends nothing if they are unchanged."""
        if program is not self._program:
            self._program = program
            self._draw_dots(np.array([self._model.frame(each.q).p for each in program.waypoints]))
        if rehearsal is not self._rehearsal:
            self._rehearsal = rehearsal
            self._draw_path(rehearsal)

    def _draw_dots(self, points: Array) -> None:
        for node in self._dots:
            node.remove()
        self._dots = []
        if len(points) == 0:
            return
        self._dots.append(
            self._scene.add_point_cloud(
                f"{_ROOT}/dots",
                points,
                np.tile(np.array(_COLOR, dtype=np.uint8), (len(points), 1)),
                point_size=0.012,
                point_shape="circle",
            )
        )
        self._dots += [
            self._scene.add_label(f"{_ROOT}/number{k}", f"{k + 1}", position=p + _ABOVE)
            for k, p in enumerate(points)
        ]

    def _draw_path(self, rehearsal: Rehearsal | None) -> None:
        if self._path is not None:
            self._path.remove()
            self._path = None
        if rehearsal is None:
            return
        legs = (*rehearsal.legs, *(() if rehearsal.back is None else (rehearsal.back,)))
        lines = [self._line(leg.plan, len(leg.indices)) for leg in legs if leg.plan is not None]
        pieces = [segments(line) for line in lines]
        if pieces:
            self._path = self._scene.add_line_segments(
                f"{_ROOT}/path",
                np.concatenate(pieces),
                _COLOR,
                thickness=3.0,
                thickness_units="screen",
            )

    def _line(self, plan: Plan, waypoints: int) -> Array:
        """Points of the tool path, shape (n, 3), [m], ``_POINTS`` for each of ``waypoints``."""
        q = plan.trajectory.q
        chosen = np.unique(np.linspace(0, len(q) - 1, _POINTS * waypoints).astype(int))
        return np.array([self._model.frame(q[k]).p for k in chosen])
