"""The Move tab of several arms: a target for each, one plan for all, and its plots."""

from __future__ import annotations

from collections.abc import Mapping

import viser

from ..cell_model import CellModel, CellScreen, CommonPlan
from ..page import markup, texts
from ..page.page_context import PageContext
from ..view_model import ViewModel
from .cell_plots import CellPlots
from .plan_controls import PlanControls
from .plan_panel import plots_panel
from .target_controls import TargetControls


class CommonPlanPanel:
    """The Move tab of several arms, and the panel with the plots of the newest plan.

    Args:
        model: What is shown of all arms.
        pages: The target of each arm, by name.
    """

    def __init__(
        self, context: PageContext, model: CellModel, pages: Mapping[str, ViewModel]
    ) -> None:
        gui, self._plan = context.gui, PlanControls(context, model)
        self._targets = {name: TargetControls(context, page) for name, page in pages.items()}
        with context.tabs.add_tab("Move"):
            self._sentence = gui.add_html("")
            self._plan.add_buttons()  # first, so that they are seen on a phone without scrolling
            arms = gui.add_tab_group()
            for name, target in self._targets.items():
                with arms.add_tab(name):
                    target.add_target()
                    target.add_jaw()
                    with gui.add_folder("More", expand_by_default=False):
                        target.add_choices()
            self._plan.add_timeline()
            self._facts = gui.add_html("")
            self._plan.add_caps()
        self._plots_panel = plots_panel(gui)
        self._plots = CellPlots(gui, self._plots_panel, tuple(pages))
        self._shown: CommonPlan | None = None

    @property
    def plan_button(self) -> viser.GuiButtonHandle:
        """The button Plan."""
        return self._plan.plan_button

    def show(self, screen: CellScreen) -> None:
        """Show ``screen``; viser sends only what differs."""
        self._sentence.content = markup.sentence(screen.sentence)
        for name, each in screen.arms.items():
            self._targets[name].show(each)
        plan = screen.plan
        if plan is not None and plan is not self._shown:
            if self._shown is None:
                self._plots_panel.expand()
            self._shown = plan
            self._plots.show(plan)
            self._plan.set_duration(plan.duration)
        self._plots.name(plan, is_current=screen.plan_is_current)
        self._plan.show(screen, self._plots.uuids)
        self._facts.content = markup.facts(plan_facts(plan if screen.plan_is_current else None))


def plan_facts(plan: CommonPlan | None) -> tuple[tuple[str, str], ...]:
    """The figures of a plan for all arms: duration, who waits for whom, clearances."""
    if plan is None:
        return (("Duration", "–"),)
    pairs = (texts.between(each.first, each.second, each.least) for each in plan.clearances)
    others = [(name, each.report.for_others) for name, each in plan.plans.items()]
    return (("Duration", f"{plan.duration:.2f} s"), *(each for each in others if each[1]), *pairs)
