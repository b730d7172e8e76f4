"""The Move tab: target, Plan, preview, Execute, gripper; and the plots of the newest plan."""

from __future__ import annotations

from collections.abc import Callable

import viser

from so101_motion.common.geometry import Array

from ..page import markup, texts
from ..page.page_context import PageContext
from ..page.screen_state import PlanView, Screen
from ..page.tracking import Tracking
from ..view_model import ViewModel
from .plan_controls import PlanControls
from .plots import PlanPlots
from .pose_folder import PoseFolder
from .poses import PoseList
from .target_controls import TargetControls

_PLOT_SIZE = (390, 305)  # between the panels of the narrowest window that has both
_MARGIN = 12

_LINES = 7
"""Lines reserved for six figures, and a clearance with long names."""

SELECTS = "selects"
"""What a click in the picture does unless it sets the target."""


def plots_panel(gui: viser.GuiApi) -> viser.PanelHandle:
    """The panel for plots, which floats at the bottom and is small until it is expanded."""
    panel = gui.add_panel()
    width, height = _PLOT_SIZE
    panel.float(x=_MARGIN, y=-_MARGIN, width=width, height=height)
    panel.minimize()
    return panel


class PlanPanel:
    """The Move tab, and the panel with the plots of the newest plan.

    Args:
        on_click: Called with what clicks in the picture do, ``SELECTS`` or another.

    What is used for every motion comes first, so that Plan and Execute are seen on a phone without
    scrolling.
    """

    def __init__(
        self,
        context: PageContext,
        page: ViewModel,
        poses: PoseList,
        *,
        on_click: Callable[[str], None],
    ) -> None:
        self._target, self._plan = TargetControls(context, page), PlanControls(context, page)
        gui = context.gui
        with context.tabs.add_tab("Move"):
            self._sentence = gui.add_html("")
            self._target.add_target()
            self._plan.add_buttons()
            self._back_out = gui.add_button(
                "Back out slowly",
                visible=False,
                hint="Plans a slow straight motion out of the contact; Execute runs it. In a"
                " surface whose inside is not known it may lead deeper.",
            )
            context.on_press(self._back_out, page.plan_back_out)
            self._plan.add_timeline()
            self._facts = gui.add_html(markup.facts(texts.NO_FACTS, lines=_LINES))
            self._plan.add_caps()
            gui.add_divider()
            self._target.add_jaw()
            gui.add_divider()
            click = gui.add_dropdown(
                "A click",
                (SELECTS, "sets the target"),
                hint="On the table or an object. A target is set 20 mm above it, from above where"
                " that can be reached.",
            )
            context.on_entry(click, on_click)
            self._target.add_choices()
            self._own_poses = PoseFolder(context, poses)
        self._plots_panel = plots_panel(gui)
        self._plots = PlanPlots(gui, self._plots_panel)
        self._shown: PlanView | None = None
        self._tracking: Tracking | None = None

    @property
    def plan_button(self) -> viser.GuiButtonHandle:
        """The button Plan."""
        return self._plan.plan_button

    def show(self, screen: Screen) -> None:
        """Show ``screen``; viser sends only what differs."""
        self._sentence.content = markup.sentence(screen.sentence)
        self._back_out.visible = screen.can_back_out
        self._target.show(screen)
        self._own_poses.show()
        if screen.plan is not None and screen.plan is not self._shown:
            self._show_plan(screen.plan, screen.range)
        if screen.tracking is not None and screen.tracking is not self._tracking:
            self._tracking = screen.tracking
            self._plots.show_tracking(screen.tracking, screen.tracked)
        plan = screen.plan if screen.plan_is_current else None
        self._plots.name(screen.plan, is_current=plan is not None)
        figures = texts.NO_FACTS if plan is None else texts.plan_facts(plan)
        self._facts.content = markup.facts(figures, lines=_LINES)
        self._plan.show(screen, self._plots.uuids)

    def _show_plan(self, view: PlanView, bounds: tuple[Array, Array]) -> None:
        if self._shown is None:
            self._plots_panel.expand()
        self._shown = view
        self._plots.show(view.plan, bounds)
        self._plan.set_duration(view.plan.duration)
