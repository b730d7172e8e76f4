"""Keep a plan beside the newest one, to compare their figures and paths."""

from __future__ import annotations

import viser

from ..page import texts
from ..page.front_tab import Drawn
from ..page.page_context import PageContext
from ..page.screen_state import PlanView
from ..page.shared_fields import ButtonRow
from ..scene.robot_view import segments

_KEEP, _FORGET = "keep this plan", "forget it"
_COLOR = (134, 142, 150)


class Comparison:
    """The buttons, the figures and the grey path of a plan that is kept."""

    def __init__(self, context: PageContext) -> None:
        self._scene, self._front = context.server.scene, context.front
        self._newest: PlanView | None = None
        self._kept: PlanView | None = None
        self._line: viser.LineSegmentsHandle | None = None
        self._buttons = ButtonRow(
            context,
            "Compare",
            (_KEEP, _FORGET),
            self._choose,
            hint="Shows its figures and its path, in grey, beside the next plan",
        )

    def _choose(self, name: str) -> None:
        self._kept = self._newest if name == _KEEP else None
        if self._line is not None:
            self._line.remove()
            self._line = None
        if self._kept is not None:
            points = self._kept.path.points
            self._line = self._scene.add_line_segments(
                "/kept-path", segments(points), _COLOR, thickness=3.0, thickness_units="screen"
            )
        self._show_buttons()

    def show(self, newest: PlanView | None) -> None:
        """Take note of the newest plan that can be kept; None when there is none."""
        self._newest = newest
        if self._line is not None:
            self._line.visible = self._front.drawn is Drawn.PLAN
        self._show_buttons()

    def _show_buttons(self) -> None:
        no_plan = "There is no plan to keep. Press Plan first."
        self._buttons.show(
            {
                _KEEP: no_plan if self._newest is None else None,
                _FORGET: "No plan is kept." if self._kept is None else None,
            }
        )

    def rows(self) -> tuple[tuple[str, ...], ...]:
        """Name, figure and, beside it, the figure of the plan that is kept."""
        facts = texts.NO_FACTS if self._newest is None else texts.plan_facts(self._newest)
        if self._kept is None:
            return facts
        now = "–" if self._newest is None else self._newest.name
        kept = texts.plan_facts(self._kept)
        pairs = zip(facts, kept, strict=True)
        return (("", now, self._kept.name), *((*fact, other) for fact, (_, other) in pairs))
