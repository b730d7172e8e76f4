"""The part that everything else is around: the arm, a target, a plan, and Execute."""

from __future__ import annotations

from collections.abc import Callable

import viser

from so101_motion.geometry import Array
from so101_motion.planning.model import RobotModel
from so101_motion.planning.plan import Plan
from so101_motion.pose_book import PoseBook

from .aim import Aimer
from .desk import Desk
from .panels import PlanPanel, StatePanel
from .poses import PoseShelf
from .stage import Stage
from .view_model import ViewModel

_WORDS_EVERY = 3
"""Joint figures are told every so many pictures of a motion; nobody reads 30 a second."""


class MovePart:
    """See the arm, choose a target, plan and execute.

    Args:
        desk: Where it works.
        title: Which arm this is.
        stops: What Stop calls, each in a thread of its own.
        plan: A plan to begin with.
    """

    def __init__(
        self,
        desk: Desk,
        *,
        title: str,
        stops: tuple[Callable[[], None], ...],
        plan: Plan | None = None,
    ) -> None:
        self._rig = desk.rig
        arm = desk.rig.arm
        model = RobotModel.load()
        self.page = ViewModel(
            arm=arm,
            gripper=desk.rig.gripper,
            load_aimer=Aimer.load,
            submit=desk.beside,
            now=desk.rig.clock.now,
            welcome=f"{title}. Drag the arrows, then press Plan.",
        )
        if plan is not None:
            self.page.show(plan)
        self._stage = Stage(desk, model=model, on_drag=self._dragged)
        self._state_panel = StatePanel(desk.gui, title=title, stops=stops)
        self._plan_panel = PlanPanel(desk, self.page, PoseShelf(PoseBook(), self.page))
        self._pictures = 0

    def _dragged(self, p_base: Array) -> None:
        self._stage.dragged_to(p_base)
        self.page.aim_at(p_base)

    @property
    def stop_widgets(self) -> tuple[viser.GuiButtonHandle | viser.CommandHandle, ...]:
        """What stops the arm: a button and keys."""
        return self._state_panel.stop_widgets

    @property
    def state_panel(self) -> viser.PanelHandle:
        """The panel with Stop."""
        return self._state_panel.panel

    def set_visible(self, visible: bool) -> None:
        """Show the arm and its target, or nothing of them."""
        self._stage.set_visible(visible)

    def set_handles(self, shown: bool) -> None:
        """Show the target's arrows, or none until the target changes."""
        self._stage.set_handles(shown)

    def fade(self, faded: bool) -> None:
        """Show the arm in grey, or in its own colours."""
        self._stage.fade(faded)

    def refresh(self) -> bool:
        """Look at the arm, the plan being made and the motion being carried out."""
        return self.page.refresh()

    def show(self) -> None:
        """Draw the arm; tell its figures now and then."""
        screen = self.page.screen()
        self._pictures += 1
        self._stage.show(screen)
        if not screen.state.arm_moving or self._pictures % _WORDS_EVERY == 0:
            lost = self._rig.connection.problem is not None
            self._state_panel.show(screen.state, screen.range, lost=lost)
            self._plan_panel.show(screen)

    def close(self) -> None:
        """Nothing is held."""
