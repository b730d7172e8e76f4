"""Draw the arm, its ghost, the target handles and the path to the target."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
import viser
from viser.transforms import SO3

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.kinematics.model import RobotModel

from ..page.page_context import Drawn, PageContext
from ..page.plan_view import PathLine
from ..page.screen_state import Tone
from ..page.target_editor import ANY
from ..scene.reach_view import ReachView
from ..scene.robot_view import MOVED_LINK, Line, RobotView, SweepView, segments
from ..view_model import ViewModel

_GHOST = (60, 130, 246)
_GHOST_BAD = (224, 49, 49)
_FADED = (150, 155, 160)
_ALARM, _WARNING = (200, 20, 40), (250, 220, 0)  # the arm itself is orange
_PATH = (240, 140, 0)
_HINT = (120, 150, 190)
_LETTERS = 0.135  # how far from the target the names of its axes stand [m]


class Stage:
    """The arm, its ghost, the target handles and the path in the scene.

    Args:
        model: Kinematics; used by the thread that calls ``show`` alone.
        root: The node that all nodes are under, placed where the arm's base stands; empty for an
            arm whose base is the origin.
        reach: Shades what is within reach while the target is dragged; None without.
        on_click: Called with the ray of a click, while clicks are wanted: where it begins, shape
            (3,), [m], and its direction, shape (3,).
    """

    def __init__(
        self,
        context: PageContext,
        page: ViewModel,
        *,
        model: RobotModel,
        on_click: Callable[[Array, Array], None] = lambda _from, _along: None,
        reach: ReachView | None = None,
        root: str = "",
    ) -> None:
        self._scene, self._model = context.server.scene, model
        self._front = context.front
        self._clicked = context.handler(
            lambda event: partial(
                on_click, np.array(event.ray_origin), np.array(event.ray_direction)
            )
        )
        self._live = RobotView(self._scene, f"{root}/live")
        self._ghost = RobotView(self._scene, f"{root}/ghost", color=_GHOST, opacity=0.35)
        self._target = self._scene.add_transform_controls(
            f"{root}/target", scale=0.11, disable_rotations=True, depth_test=False
        )
        letters = () if root else "XYZ"  # those of several arms would lie over each other
        for axis, p in zip(letters, _LETTERS * np.eye(3), strict=False):
            self._scene.add_label(
                f"{root}/target/{axis}",
                axis,
                position=p,
                anchor="center-center",
            )
        self._page, self._reach = page, reach
        context.on_drag(self._target, self._dragged, self._released)
        self._sweep = SweepView(self._scene, f"{root}/sweep", color=_GHOST)
        self._p_target, self._R_target, self._turns = np.full(3, np.nan), np.eye(3), False
        self._path: PathLine | None = None
        self._line = Line(self._scene, f"{root}/path")
        self._visible = self._has_handles = True
        self._is_faded, self._marks = False, dict[str, Tone]()
        self._is_dragged = False  # a browser has the handles where its hand is

    def set_visible(self, visible: bool) -> None:
        self._visible = visible
        self._live.set_visible(visible)
        self._ghost.set_visible(visible)
        self._sweep.set_visible(visible)
        self._target.visible = visible and self._has_handles
        self._line.set_visible(visible)

    def set_clickable(self, wanted: bool) -> None:
        if wanted:
            self._scene.on_click()(self._clicked)
        else:
            self._scene.remove_click_callback("all")

    def set_handles(self, shown: bool) -> None:
        """Show or hide the target's arrows; they come back when the target changes."""
        self._has_handles = shown
        self._target.visible = self._visible and shown

    def _dragged(self, handle: viser.TransformControlsHandle) -> None:
        self._is_dragged = True
        p_base = np.array(handle.position)
        if np.allclose(p_base, self._p_target, atol=1e-6):  # only turned
            self._page.set_turn(np.array(SO3(np.array(handle.wxyz)).as_matrix(), dtype=np.float64))
        else:
            self._p_target = p_base  # the browsers show it already
            self._page.set_target_point(p_base)
            if self._reach is not None:
                self._reach.show(self._page.target.frame, float(p_base[2]))

    def _released(self) -> None:
        self._is_dragged = False
        self._show_handles()
        if self._reach is not None:
            self._reach.hide()

    def _show_handles(self) -> None:
        self._target.position, self._target.wxyz = (
            self._p_target,
            SO3.from_matrix(self._R_target if self._turns else np.eye(3)).wxyz,
        )

    def fade(self, faded: bool) -> None:
        """Show the arm in grey because its position is not certain, or in its own colours."""
        self._is_faded = faded
        self._paint()

    def mark(self, joints: Mapping[str, Tone]) -> None:
        self._marks = dict(joints)
        self._paint()

    def _paint(self) -> None:
        if self._is_faded:
            self._live.paint(_FADED)
            return
        self._live.repaint()
        for joint, tone in self._marks.items():
            self._live.paint(_ALARM if tone is Tone.BAD else _WARNING, {MOVED_LINK[joint]})

    def show(self) -> None:
        page, state = self._page, self._page.state
        T_live = self._model.link_placements(state.q, state.q_jaw)
        self._live.move(T_live)
        self._show_ghost(T_live)
        turns, R_target = page.kind != ANY, page.R_base_target
        is_turned = turns and not np.array_equal(R_target, self._R_target)
        self._R_target = R_target
        if turns != self._turns:
            self._turns = turns
            self._target.disable_rotations = not turns
            self._show_handles()
        elif is_turned and not self._is_dragged:
            self._show_handles()
        if not np.array_equal(page.target.p_base, self._p_target):
            self._p_target = page.target.p_base
            self._show_handles()
            self.set_handles(True)
        has_plan = self._front.drawn is Drawn.PLAN
        self._sweep.show(page.sweep if has_plan else None, state.q_jaw, self._model)
        path = page.path if has_plan else None
        if path is not self._path:
            self._path = path
            if path is None:
                self._line.show(None, _PATH)
            elif path.planned:
                self._line.show(segments(path.points), _PATH, 4.0)
            else:
                dashes = segments(path.points)[::2]  # a guess shall not look like a plan
                self._line.show(dashes, _HINT, 2.0)

    def _show_ghost(self, T_live: dict[str, SE3]) -> None:
        page, drawn = self._page, self._front.drawn
        q_ghost = page.target.q if drawn is Drawn.TARGET else page.q_ghost
        if q_ghost is None or drawn is Drawn.NOTHING:
            self._ghost.show(())
            return
        T_ghost = self._model.link_placements(q_ghost, page.state.q_jaw)
        self._ghost.move_beside(T_ghost, T_live)
        is_bad = page.target.problem is not None or page.target is page.refused
        self._ghost.paint(_GHOST_BAD if is_bad else _GHOST)
