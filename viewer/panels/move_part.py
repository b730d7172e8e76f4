"""Connect the arm's view model with the scene, the arm panel and the Move tab."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import viser

from so101_motion.common.geometry import Array
from so101_motion.files.saved_poses import SavedPoses
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.request import Plan
from so101_motion.tasks.sweeps.atlas import Atlas

from ..page.front_tab import Drawn
from ..page.page_context import ArmContext
from ..page.part import Part
from ..page.screen_state import Sentence, Tone
from ..page.stop_button import add_stop
from ..page.target_ik import TargetSolver
from ..scene.camera_and_lights import Views, set_up_view
from ..scene.click import hit
from ..scene.measuring import Measuring
from ..scene.reach_view import ReachView
from ..scene.stage import Stage
from ..view_model import ViewModel
from .arm_panel import ArmPanel, docked_left
from .plan_panel import MEASURES, SELECTS, PlanPanel
from .poses import PoseList

_WORDS_EVERY = 3
"""Figures are updated every so many pictures of a motion; nobody reads 30 a second."""


class MovePart(Part):
    """The part of the page that shows and moves the arm.

    Args:
        stops: What Stop calls, each in a thread of its own.
        atlas: Is shaded while the target is dragged; without one the reach is computed.

    Attributes:
        stop_button: What the bar's Stop presses.
    """

    def __init__(
        self,
        context: ArmContext,
        *,
        title: str,
        stops: tuple[Callable[[], None], ...],
        plan: Plan | None = None,
        atlas: Atlas | None = None,
    ) -> None:
        self._arm = arm = context.rig.arm
        model = RobotModel.load()
        self.page = ViewModel(
            arm=arm,
            gripper=context.rig.gripper,
            load_solver=TargetSolver.load,
            submit=context.in_background,
            now=context.rig.clock.now,
            welcome=f"{title}. Drag the arrows, then press Plan.",
        )
        if plan is not None:
            self.page.show(plan)
        set_up_view(context.server)
        views = Views(context.server)
        context.bar.views = views.buttons
        context.leave_open(*(button for _, button in views.buttons))
        self._reach = ReachView(context.server.scene, model, atlas)
        self._stage = Stage(
            context,
            model=model,
            views=views,
            on_drag=self._dragged,
            on_turn=self.page.set_turn,
            on_release=self._reach.hide,
            on_click=self._clicked,
        )
        self.stop_button = add_stop(context.gui, *stops)
        self._panel = docked_left(context.gui)
        self._arm_panel = ArmPanel(context.gui, self._panel)
        self._plan_panel = PlanPanel(
            context,
            self.page,
            PoseList(SavedPoses(zeros=lambda: context.rig.connection.encoder_zeros), self.page),
            on_click=self._set_click,
        )
        context.bar.stop, context.bar.plan = self.stop_button, self._plan_panel.plan_button
        self._measuring, self._measures = Measuring(context.server.scene), False
        self._pictures = 0
        self._front, self._drawn = context.front, Drawn.PLAN

    def _set_click(self, does: str) -> None:
        self._measures = does == MEASURES
        self._measuring.clear()
        self._stage.set_clickable(does != SELECTS)

    def _clicked(self, p_from: Array, along: Array) -> None:
        met = hit(self._arm.scene, p_from, along)
        if met is not None and self._measures:
            self.page.tell(Sentence(text=self._measuring.take(met)))
        elif met is not None:
            self.page.set_target_above(met)

    def _dragged(self, p_base: Array) -> None:
        self._stage.dragged_to(p_base)
        self.page.set_target_point(p_base)
        self._reach.show(self.page.target.frame, float(p_base[2]))

    @property
    def arm_panel(self) -> viser.PanelHandle:
        """The panel with the joints."""
        return self._panel

    def set_visible(self, visible: bool) -> None:
        """Show or hide the arm and its target."""
        self._stage.set_visible(visible)

    def set_handles(self, shown: bool) -> None:
        """Show the target's arrows, or hide them until the target changes."""
        self._stage.set_handles(shown)

    def fade(self, faded: bool) -> None:
        """Show the arm in grey, or in its own colours."""
        self._stage.fade(faded)

    def mark(self, joints: Mapping[str, Tone]) -> None:
        """Colour the links that these joints move, each in the tone of its alarm."""
        self._stage.mark(joints)

    def refresh(self) -> bool:
        """Take in the state of the arm, the plan being made and the running motion."""
        is_other = self._front.drawn is not self._drawn
        return self.page.refresh() or is_other

    def show(self) -> None:
        """Draw the arm; update its figures now and then."""
        screen, self._drawn = self.page.screen(), self._front.drawn
        self._pictures += 1
        self._stage.show(screen)
        if not screen.state.arm_moving or self._pictures % _WORDS_EVERY == 0:
            self._arm_panel.show(screen.state, screen.range)
            self._plan_panel.show(screen)
