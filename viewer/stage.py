"""The scene: a floor, the arm, its ghost, the target to drag and the way to it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import viser

from so101_motion.geometry import SE3, Array, rotation_angle
from so101_motion.planning.model import RobotModel
from so101_motion.planning.scene import Scene

from .desk import Desk
from .robot_view import RobotView
from .scene_view import SceneView
from .screen import Screen, Way

_GHOST = (60, 130, 246)
_GHOST_BAD = (224, 49, 49)
_WAY = (240, 140, 0)
_HINT = (120, 150, 190)
_CAMERA = (0.78, -1.14, 0.62)
_LOOK_AT = (0.17, -0.02, 0.05)
_FIELD_OF_VIEW = math.radians(36.0)
"""Chosen: the whole workspace in the picture, the arm a little above the middle."""


class Stage:
    """What there is to see.

    Args:
        desk: Whose page it is.
        model: Kinematics; used by the thread that calls ``show`` alone.
        surroundings: What stands around the arm and what it holds.
        on_drag: Called with the new target point, shape (3,), [m].
    """

    def __init__(
        self,
        desk: Desk,
        *,
        model: RobotModel,
        surroundings: Scene,
        on_drag: Callable[[Array], None],
    ) -> None:
        self._scene, self._model = desk.server.scene, model
        _furnish(desk.server, surroundings.floor_z)
        self._around = SceneView(self._scene, surroundings)
        self._live = RobotView(self._scene, "/live")
        self._ghost = RobotView(self._scene, "/ghost", color=_GHOST, opacity=0.35)
        self._target = self._scene.add_transform_controls(
            "/target", scale=0.11, disable_rotations=True, depth_test=False
        )
        desk.on_drag(self._target, lambda handle: on_drag(np.array(handle.position)))
        self._p_target = np.full(3, np.nan)
        self._way: Way | None = None
        self._way_node: viser.LineSegmentsHandle | None = None

    def dragged_to(self, p_base: Array) -> None:
        """Note that the browsers already show the target at ``p_base``, shape (3,), [m]."""
        self._p_target = p_base

    def show(self, screen: Screen) -> None:
        """Draw ``screen``; only what differs is sent."""
        state = screen.state
        T_live = self._model.link_placements(state.q, state.q_jaw)
        self._live.move(T_live)
        if self._around.holds:
            self._around.move(self._model.frame(state.q))
        self._show_ghost(screen, T_live)
        if not np.array_equal(screen.aim.p_base, self._p_target):
            self._p_target = screen.aim.p_base
            self._target.position = screen.aim.p_base
        if screen.way is not self._way:
            self._way = screen.way
            self._draw_way()

    def _show_ghost(self, screen: Screen, T_live: dict[str, SE3]) -> None:
        if screen.q_ghost is None:
            self._ghost.show(())
            return
        T_ghost = self._model.link_placements(screen.q_ghost, screen.state.q_jaw)
        self._ghost.move(T_ghost)
        self._ghost.show({link for link in T_ghost if _apart(T_ghost[link], T_live[link])})
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
        )


def _apart(T: SE3, other: SE3) -> bool:
    """Whether two placements differ to the eye; surfaces in one place would flicker."""
    turned = rotation_angle(T.R.T @ other.R)
    return bool(np.linalg.norm(T.p - other.p) > 0.002 or turned > math.radians(1.0))


def _furnish(server: viser.ViserServer, floor_z: float | None) -> None:
    server.scene.set_up_direction("+z")
    server.initial_camera.position = _CAMERA
    server.initial_camera.look_at = _LOOK_AT
    server.initial_camera.fov = _FIELD_OF_VIEW
    server.scene.configure_default_lights(cast_shadow=True)
    server.scene.configure_environment_map("studio", environment_intensity=0.4)
    if floor_z is not None:
        server.scene.add_grid(
            "/floor",
            width=1.2,
            height=1.2,
            cell_size=0.05,
            section_size=0.25,
            cell_color=(222, 226, 230),
            section_color=(173, 181, 189),
            shadow_opacity=0.25,
            position=(0.0, 0.0, floor_z),
        )
