"""Draw the arm of the setup, a model of its own that replaces the preview's arm meanwhile."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import viser

from so101_motion.common.geometry import SE3
from so101_motion.common.operation import Picture as ViewPicture
from so101_motion.planning.kinematics.model import RobotModel

from ..scene.robot_view import MOVED_LINK, Color, RobotView

ORANGE: Color = (245, 130, 0)
GREEN: Color = (60, 160, 80)
_PALE: Color = (196, 202, 208)
_GHOST: Color = (60, 130, 246)

_AT_REST = ViewPicture(q=(0.0, 0.0, 0.0, 0.0, 0.0, 0.6))  # the jaw is open, to be seen


class Picture:
    """The drawn arm of the setup."""

    def __init__(self, scene: viser.SceneApi, on_stage: Callable[[bool], None]) -> None:
        self._on_stage = on_stage
        self._model = RobotModel.load()
        self._root = scene.add_frame("/setup", show_axes=False, visible=False)
        self._arm = RobotView(scene, "/setup/arm", color=_PALE)
        self._arm.set_visible(False)  # its meshes are sent when it is first shown
        self._ghost = RobotView(scene, "/setup/ghost", color=_GHOST, opacity=0.35)
        self._ghost.show(())
        self.is_shown = self.is_drawn = False
        self._lit: tuple[tuple[str, ...], Color] | None = None
        self.rest()

    def take_stage(self, shown: bool) -> None:
        """Show it instead of the preview's arm, or the reverse."""
        if shown != self.is_shown:
            self.is_shown = shown
            self._root.visible = shown
            self._arm.set_visible(shown)
            self._on_stage(not shown)

    def rest(self) -> None:
        """Show a pale arm in a plain pose without highlights and ghost, as each step starts."""
        self.draw(_AT_REST)
        self.is_drawn = False

    def draw(self, picture: ViewPicture) -> None:
        """Draw arm, ghost and highlights of an operation's picture."""
        self.is_drawn = True
        T_arm = self._placed(picture.q)
        self._arm.move(T_arm)
        if picture.ghost:
            self._ghost.move_beside(self._placed(picture.ghost), T_arm)
        else:
            self._ghost.show(())
        lit = (picture.lit, GREEN if picture.lit_tone == "good" else ORANGE)
        if lit != self._lit:
            self._lit = lit
            self._arm.paint(_PALE)
            self._arm.paint(lit[1], {MOVED_LINK[joint] for joint in lit[0]})

    def _placed(self, q: tuple[float, ...]) -> dict[str, SE3]:
        return self._model.link_placements(np.array(q[:-1]), q[-1])
