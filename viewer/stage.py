"""The scene: the arm, its ghost, the target to drag and the way to it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import viser

from so101_motion.geometry import SE3, Array, rotation_angle
from so101_motion.planning.model import RobotModel

from .desk import Desk
from .robot_view import RobotView
from .screen import Screen, Way
from .studio import furnish
from .sweep_view import SweepView

_GHOST = (60, 130, 246)
_GHOST_BAD = (224, 49, 49)
_FADED = (150, 155, 160)
_WAY = (240, 140, 0)
_HINT = (120, 150, 190)


class Stage:
    """What there is to see.

    Args:
        desk: Whose page it is.
        model: Kinematics; used by the thread that calls ``show`` alone.
        on_drag: Called with the new target point, shape (3,), [m].
    """

    def __init__(
        self,
        desk: Desk,
        *,
        model: RobotModel,
        on_drag: Callable[[Array], None],
    ) -> None:
        self._scene, self._model = desk.server.scene, model
        furnish(desk.server)
        self._live = RobotView(self._scene, "/live")
        self._ghost = RobotView(self._scene, "/ghost", color=_GHOST, opacity=0.35)
        self._target = self._scene.add_transform_controls(
            "/target", scale=0.11, disable_rotations=True, depth_test=False
        )
        desk.on_drag(self._target, lambda handle: on_drag(np.array(handle.position)))
        self._sweep = SweepView(self._scene, "/sweep", color=_GHOST)
        self._p_target = np.full(3, np.nan)
        self._way: Way | None = None
        self._way_node: viser.LineSegmentsHandle | None = None
        self._visible = self._has_handles = True

    def set_visible(self, visible: bool) -> None:
        """Show all this, or make room for something else; takes effect at once."""
        self._visible = visible
        self._live.set_visible(visible)
        self._ghost.set_visible(visible)
        self._sweep.set_visible(visible)
        self._target.visible = visible and self._has_handles
        if self._way_node is not None:
            self._way_node.visible = visible

    def set_handles(self, shown: bool) -> None:
        """Show the target's arrows, or leave the stage to the handles of something else.

        They come back by themselves when the target changes.
        """
        self._has_handles = shown
        self._target.visible = self._visible and shown

    def dragged_to(self, p_base: Array) -> None:
        """Note that the browsers already show the target at ``p_base``, shape (3,), [m]."""
        self._p_target = p_base

    def fade(self, faded: bool) -> None:
        """Show the arm in grey because it may be elsewhere by now, or in its own colours."""
        if faded:
            self._live.paint(_FADED)
        else:
            self._live.repaint()

    def show(self, screen: Screen) -> None:
        """Draw ``screen``; only what differs is sent."""
        state = screen.state
        T_live = self._model.link_placements(state.q, state.q_jaw)
        self._live.move(T_live)
        self._show_ghost(screen, T_live)
        if not np.array_equal(screen.aim.p_base, self._p_target):
            self._p_target = screen.aim.p_base
            self._target.position = screen.aim.p_base
            self.set_handles(True)
        self._sweep.show(screen.sweep, state.q_jaw, self._model)
        if screen.way is not self._way:
            self._way = screen.way
            self._draw_way()

    def _show_ghost(self, screen: Screen, T_live: dict[str, SE3]) -> None:
        if screen.q_ghost is None:
            self._ghost.show(())
            return
        T_ghost = self._model.link_placements(screen.q_ghost, screen.state.q_jaw)
        self._ghost.show({link for link in T_ghost if _apart(T_ghost[link], T_live[link])})
        self._ghost.move(T_ghost)
        self._ghost.paint(_GHOST if screen.aim.problem is None else _GHOST_BAD)

    def _draw_way(self) -> None:
        if self._way_node is not None:
            self._way_node.remove()
            self._way_node = None
        if self._way is None:
            return
        points = self._way.points
        pieces = np.stack([points[:-1], points[1:]], axis=1)
        if not self._way.planned:
            pieces = pieces[::2]  # dashes: a guess shall not look like a plan
        self._way_node = self._scene.add_line_segments(
            "/way",
            pieces,
            _WAY if self._way.planned else _HINT,
            thickness=4.0 if self._way.planned else 2.0,
            thickness_units="screen",
            visible=self._visible,
        )


def _apart(T: SE3, other: SE3) -> bool:
    """Whether two placements differ to the eye; surfaces in one place would flicker."""
    turned = rotation_angle(T.R.T @ other.R)
    return bool(np.linalg.norm(T.p - other.p) > 0.002 or turned > math.radians(1.0))
