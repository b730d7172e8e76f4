"""Draw the arm of the setup: which motor is meant, where the joints are and should be.

It is a model of its own under ``/setup`` and replaces the preview's arm during a setup.
"""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np
import viser

from so101_motion.common.geometry import Array
from so101_motion.common.operation import Picture as ViewPicture
from so101_motion.planning.kinematics.model import RobotModel

from ..scene.robot_view import MOVED_LINK, Color, RobotView, looks_different

ORANGE: Color = (245, 130, 0)
GREEN: Color = (60, 160, 80)
_PALE: Color = (196, 202, 208)
_GHOST: Color = (60, 130, 246)

_Q_SHOWN = np.zeros(5)
_Q_JAW_SHOWN = 0.6  # [rad], open, so that the jaw is seen as a part of its own


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
        self.is_shown = False
        self._lit: tuple[Collection[str], Color] | None = None
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
        self.move(_Q_SHOWN, _Q_JAW_SHOWN)
        self.ghost(None)
        self.light(())

    def light(self, joints: Collection[str], color: Color = ORANGE) -> None:
        if (joints, color) != self._lit:
            self._lit = (joints, color)
            self._arm.paint(_PALE)
            self._arm.paint(color, {MOVED_LINK[joint] for joint in joints})

    def draw(self, picture: ViewPicture) -> None:
        *q, q_jaw = picture.q
        self.move(np.array(q), q_jaw)
        *q_ghost, q_jaw_ghost = picture.ghost or (0.0,)
        self.ghost(np.array(q_ghost) if q_ghost else None, q_jaw_ghost)
        self.light(picture.lit, GREEN if picture.lit_tone == "good" else ORANGE)

    def move(self, q: Array, q_jaw: float) -> None:
        """Put the joints to ``q``, shape (5,), and the jaw to ``q_jaw`` [rad]."""
        self._T_arm = self._model.link_placements(q, q_jaw)
        self._arm.move(self._T_arm)

    def ghost(self, q: Array | None, q_jaw: float = _Q_JAW_SHOWN) -> None:
        """Show a transparent arm at ``q``, shape (5,), [rad], to be matched; None to hide it.

        Links that are where the arm's are stay hidden: two surfaces in one place would flicker.
        """
        if q is None:
            self._ghost.show(())
            return
        T_base = self._model.link_placements(q, q_jaw)
        self._ghost.move(T_base)
        T_arm = self._T_arm
        self._ghost.show({link for link in T_base if looks_different(T_base[link], T_arm[link])})
