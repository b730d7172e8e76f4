"""A program on the stage: its waypoints as numbered dots, and the planned way through them.

Dots carry numbers, not names: what somebody typed never becomes part of the scene.
"""

from __future__ import annotations

import numpy as np
import viser

from so101_motion.geometry import Array
from so101_motion.planning.model import RobotModel
from so101_motion.planning.plan import Plan
from so101_motion.program import Program, Rehearsal

_COLOR = (147, 51, 234)
_ROOT = "/program"
_ABOVE = np.array([0.0, 0.0, 0.015])

_POINTS = 32
"""How many points of the tool's way are drawn for each waypoint; chosen."""


class ProgramView:
    """Draws a program and its plan.

    Args:
        scene: Where to draw them.
        model: Kinematics; used by the thread that calls ``show`` alone.
    """

    def __init__(self, scene: viser.SceneApi, model: RobotModel) -> None:
        self._scene, self._model = scene, model
        self._program: Program | None = None
        self._rehearsal: Rehearsal | None = None
        self._dots: list[viser.SceneNodeHandle] = []
        self._way: viser.LineSegmentsHandle | None = None

    def show(self, program: Program, rehearsal: Rehearsal | None) -> None:
        """Draw them; nothing is sent when they are those drawn last."""
        if program is not self._program:
            self._program = program
            self._draw_dots(np.array([self._model.frame(each.q).p for each in program.waypoints]))
        if rehearsal is not self._rehearsal:
            self._rehearsal = rehearsal
            self._draw_way(rehearsal)

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

    def _draw_way(self, rehearsal: Rehearsal | None) -> None:
        if self._way is not None:
            self._way.remove()
            self._way = None
        if rehearsal is None:
            return
        legs = (*rehearsal.legs, *(() if rehearsal.back is None else (rehearsal.back,)))
        lines = [self._line(leg.plan, len(leg.indices)) for leg in legs if leg.plan is not None]
        pieces = [np.stack([line[:-1], line[1:]], axis=1) for line in lines]
        if pieces:
            self._way = self._scene.add_line_segments(
                f"{_ROOT}/way",
                np.concatenate(pieces),
                _COLOR,
                thickness=3.0,
                thickness_units="screen",
            )

    def _line(self, plan: Plan, waypoints: int) -> Array:
        """Points of the tool's way, as many as it takes to see ``waypoints`` of them, (n, 3)."""
        q = plan.trajectory.q
        chosen = np.unique(np.linspace(0, len(q) - 1, _POINTS * waypoints).astype(int))
        return np.array([self._model.frame(q[k]).p for k in chosen])
