"""The part that everything else is around: the arm, a target, a plan, and Execute."""

from __future__ import annotations

from collections.abc import Callable

from so101_motion.geometry import Array
from so101_motion.planning.model import RobotModel
from so101_motion.planning.plan import Plan

from .aim import Aimer
from .desk import Desk
from .panels import PlanPanel, StatePanel
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
        arm = desk.rig.arm
        model = RobotModel.load()
        self.page = ViewModel(
            arm=arm,
            gripper=desk.rig.gripper,
            aimer=Aimer.load(scene=arm.scene),
            submit=desk.beside,
            welcome=f"{title}. Drag the arrows, then press Plan.",
        )
        if plan is not None:
            self.page.show(plan)
        self._stage = Stage(desk, model=model, surroundings=arm.scene, on_drag=self._dragged)
        self._state_panel = StatePanel(
            desk.gui, title=title, lower=model.lower, upper=model.upper, stops=stops
        )
        self._plan_panel = PlanPanel(desk, self.page)
        self._pictures = 0

    def _dragged(self, p_base: Array) -> None:
        self._stage.dragged_to(p_base)
        self.page.aim_at(p_base)

    def refresh(self) -> bool:
        """Look at the arm, the plan being made and the motion being carried out."""
        return self.page.refresh()

    def show(self) -> None:
        """Draw the arm; tell its figures now and then."""
        screen = self.page.screen()
        self._pictures += 1
        self._stage.show(screen)
        if not screen.state.arm_moving or self._pictures % _WORDS_EVERY == 0:
            self._state_panel.show(screen.state)
            self._plan_panel.show(screen)

    def close(self) -> None:
        """Nothing is held."""
