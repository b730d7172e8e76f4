"""The Move tab: targets, Plan, preview, Execute, grippers; and the plots of the newest plan."""

from __future__ import annotations

from collections.abc import Callable

import viser

from ..cell_model import CellModel, CommonPlan
from ..page import markup, texts
from ..page.page_context import PageContext
from ..view_model import ViewModel
from .plan_controls import PlanControls
from .plots import PlanPlots
from .poses import PoseFolder, PoseList
from .target_controls import TargetControls

_LINES = 7
"""Lines reserved for six figures, and a clearance with long names."""

SELECTS = "selects"
"""What a click in the picture does unless it sets the target."""


class PlanPanel:
    """The Move tab, and the panel with the plots of the newest plan.

    What is used for every motion comes first, so that Plan and Execute are seen on a phone without
    scrolling.

    Args:
        model: What is shown of all arms.
        poses: The poses of a single arm; None for several.
        on_click: Called with what clicks in the picture do, ``SELECTS`` or another.
    """

    def __init__(
        self,
        context: PageContext,
        model: ViewModel | CellModel,
        poses: PoseList | None,
        *,
        on_click: Callable[[str], None],
    ) -> None:
        self._context, self._model, self._plan = context, model, PlanControls(context, model)
        self._targets = {name: TargetControls(context, page) for name, page in model.arms.items()}
        self._own_poses: PoseFolder | None = None
        with context.tabs.add_tab("Move"):
            self._sentence = context.gui.add_html("")
            if poses is None:
                self._add_several()
            else:
                self._add_one(model.arms[""], poses, on_click)
        self._plots = PlanPlots(context.gui, tuple(model.arms))

    def _add_several(self) -> None:
        gui = self._context.gui
        self._plan.add_buttons()
        arms = gui.add_tab_group()
        for name, target in self._targets.items():
            with arms.add_tab(name):
                target.add_target()
                target.add_jaw()
                with gui.add_folder("More", expand_by_default=False):
                    target.add_choices()
        self._add_plan()

    def _add_one(self, page: ViewModel, poses: PoseList, on_click: Callable[[str], None]) -> None:
        context, gui, target = self._context, self._context.gui, self._targets[""]
        target.add_target()
        self._plan.add_buttons()
        self._back_out = gui.add_button(
            "Back out slowly",
            visible=False,
            hint="Plans a slow straight motion out of the contact; Execute runs it. In a surface"
            " whose inside is not known it may lead deeper.",
        )
        context.on_press(self._back_out, page.plan_back_out)
        self._add_plan()
        gui.add_divider()
        target.add_jaw()
        gui.add_divider()
        click = gui.add_dropdown(
            "A click",
            (SELECTS, "sets the target"),
            hint="On the table or an object. A target is set 20 mm above it, from above where"
            " that can be reached.",
        )
        context.on_entry(click, on_click)
        target.add_choices()
        self._own_poses = PoseFolder(context, poses)

    def _add_plan(self) -> None:
        self._plan.add_timeline()
        self._facts = self._context.gui.add_html("")
        self._plan.add_caps()

    @property
    def plan_button(self) -> viser.GuiButtonHandle:
        """The button Plan."""
        return self._plan.plan_button

    def show(self) -> None:
        """Show the model; viser sends only what differs."""
        model = self._model
        self._sentence.content = markup.sentence(model.sentence)
        for target in self._targets.values():
            target.show()
        if self._own_poses is not None:
            self._own_poses.show()
        self._plots.show(model)
        self._plan.show(self._plots.uuids)
        if isinstance(model, CellModel):
            common = model.plan_view if model.plan_is_current else None
            self._facts.content = markup.facts(plan_facts(common))
        else:
            self._back_out.visible = model.can_back_out
            plan = model.plan_view if model.plan_is_current else None
            figures = texts.NO_FACTS if plan is None else texts.plan_facts(plan)
            self._facts.content = markup.facts(figures, lines=_LINES)


def plan_facts(plan: CommonPlan | None) -> tuple[tuple[str, str], ...]:
    """The figures of a plan for all arms: duration, who waits for whom, clearances."""
    if plan is None:
        return (("Duration", "–"),)
    pairs = (texts.between(each.first, each.second, each.least) for each in plan.clearances)
    others = [(name, each.report.for_others) for name, each in plan.plans.items()]
    return (("Duration", f"{plan.duration:.2f} s"), *(each for each in others if each[1]), *pairs)
