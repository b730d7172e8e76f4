"""Draw a program: its waypoints as numbered dots, the planned path, and the ghost of a rehearsal.

Dots carry numbers, not names: typed text never becomes part of the scene.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import viser

from so101_motion.arm.cell_member import Stand
from so101_motion.common.geometry import Array
from so101_motion.common.state import JointState
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.program import Program, Rehearsal

from ..scene.robot_view import Line, RobotView, segments

_COLOR = (147, 51, 234)
_ABOVE = np.array([0.0, 0.0, 0.015])

_EMPTY = Program()


class ProgramView:
    """Draws a program and its plan, for one arm, under the node of its base.

    ``on_pick`` connects clicks on a dot with its step's index. Only ``show`` uses the ``model``.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        model: RobotModel,
        on_pick: Callable[[viser.SceneNodeHandle, int], None],
        *,
        arm: str,
        root: str,
    ) -> None:
        self._scene, self._model, self._on_pick = scene, model, on_pick
        self._arm, self._root = arm, root
        self._ghost = RobotView(scene, f"{root}/ghost", color=_COLOR, opacity=0.35)
        self._ghost.show(())
        self._program: Program | None = None
        self._rehearsal: Rehearsal | None = None
        self._dots: list[viser.SceneNodeHandle] = []
        self._path = Line(scene, f"{root}/path")

    def show(
        self, program: Program, rehearsal: Rehearsal | None, ghost: Stand | None, arm: JointState
    ) -> None:
        self._show_ghost(ghost, arm)
        self._draw(program, rehearsal)

    def hide(self) -> None:
        self._ghost.show(())
        self._draw(_EMPTY, None)

    def _show_ghost(self, ghost: Stand | None, arm: JointState) -> None:
        """Show a ghost, or none; its links that stand where those of the ``arm`` do are hidden."""
        if ghost is None:
            self._ghost.show(())
            return
        T_ghost = self._model.link_placements(ghost.q, ghost.q_jaw)
        T_arm = self._model.link_placements(arm.q, arm.q_jaw)
        self._ghost.move_beside(T_ghost, T_arm)

    def _draw(self, program: Program, rehearsal: Rehearsal | None) -> None:
        if program is not self._program:
            self._program = program
            steps = enumerate(program.steps)
            self._draw_dots(
                {
                    k: self._model.frame(each[self._arm].q).p
                    for k, each in steps
                    if self._arm in each
                }
            )
        if rehearsal is not self._rehearsal:
            self._rehearsal = rehearsal
            self._draw_path(rehearsal)

    def _draw_dots(self, points: Mapping[int, Array]) -> None:
        for node in self._dots:
            node.remove()
        self._dots = []
        if not points:
            return
        self._dots.append(self._scene.add_frame(f"{self._root}/dots", show_axes=False))
        for k, p in points.items():
            dot = self._scene.add_icosphere(
                f"{self._root}/dots/{k}", radius=0.007, color=_COLOR, position=p, cast_shadow=False
            )
            self._on_pick(dot, k)
        numbers: dict[tuple[float, ...], list[int]] = {}  # of the steps at one place
        for k, p in points.items():
            numbers.setdefault(tuple(p.round(3)), []).append(k)
        for steps in numbers.values():
            text = ", ".join(f"{k + 1}" for k in steps)
            place = points[steps[0]] + _ABOVE
            label = self._scene.add_label(f"{self._root}/number{steps[0]}", text, position=place)
            self._dots.append(label)

    def _draw_path(self, rehearsal: Rehearsal | None) -> None:
        legs = () if rehearsal is None else rehearsal.legs
        plans = (leg.plans.get(self._arm) for leg in legs)
        pieces = [segments(plan.tool_path) for plan in plans if plan is not None]
        self._path.show(np.concatenate(pieces) if pieces else None, _COLOR)
