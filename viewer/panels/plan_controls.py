"""Widgets that plan, preview and execute a motion of one arm or of several together."""

from __future__ import annotations

import math
from collections.abc import Callable

import viser

from so101_motion.common.attributes import ACCELERATION_RANGE_DEG, SPEED_RANGE_DEG
from so101_motion.common.units import to_deg, to_rad

from ..cell_model import CellModel
from ..page.bar import board, uuid_of
from ..page.page_context import PageContext
from ..page.playback import RATES
from ..page.shared_fields import SharedField, grey, put
from ..view_model import ViewModel

_RATE_NAMES = {f"{rate:g}×": rate for rate in RATES}


class PlanControls:
    """Adds widgets for plans where its methods are called.

    Attributes:
        plan_button: The button Plan.
    """

    plan_button: viser.GuiButtonHandle

    def __init__(self, context: PageContext, page: ViewModel | CellModel) -> None:
        self._context, self._page = context, page

    def add_buttons(self) -> None:
        """Plan and Execute."""
        gui = self._context.gui
        # The key P presses it; no key executes, so that people look at the plan first.
        self.plan_button = gui.add_button("Plan", icon=viser.Icon.ROUTE)
        self._context.on_press(self.plan_button, self._page.plan)
        self._execute = gui.add_button(
            "Execute", icon=viser.Icon.PLAYER_PLAY, color="green", disabled=True
        )
        self._context.on_press(self._execute, self._page.execute)
        self._progress = gui.add_progress_bar(0.0, color="green")

    def add_timeline(self) -> None:
        """The ghost on the plan's timeline."""
        gui = self._context.gui
        self._preview = gui.add_slider("Preview (s)", 0.0, 1.0, 0.01, 0.0, disabled=True)
        self._preview_time = SharedField(
            self._preview, self._page.preview, self._context, shown=lambda t: round(t, 2)
        )
        self._play = gui.add_button_group(
            "Play",
            tuple(_RATE_NAMES),
            hint="Plays only the ghost, at this fraction of the arm's speed; press again to pause",
        )
        self._context.on_choice(self._play, lambda name: self._page.play(_RATE_NAMES[name]))

    def add_caps(self) -> None:
        """How fast the next plan may be, and whether configurations along it are drawn."""
        gui = self._context.gui
        self._now = gui.add_html("", visible=False)
        self._caps_deg = (
            self._add_cap("Speed (°/s)", SPEED_RANGE_DEG, self._page.set_speed),
            self._add_cap("Accel. (°/s²)", ACCELERATION_RANGE_DEG, self._page.set_acceleration),
        )
        sweep = gui.add_checkbox("Swept motion", True)
        self._sweeps = SharedField(sweep, self._page.show_sweep, self._context, shown=bool)

    def _add_cap(
        self, label: str, range_deg: tuple[float, float], command: Callable[[float], None]
    ) -> SharedField:
        slowest, fastest = (round(end) for end in range_deg)
        return SharedField(
            self._context.gui.add_slider(label, slowest, fastest, 1, slowest),
            lambda value: command(to_rad(value)),
            self._context,
            shown=round,
        )

    def show(self, plots: list[str]) -> None:
        """Update the widgets; viser sends only what differs.

        Args:
            plots: The ids of the plots over the time of the plan.
        """
        page = self._page
        if page.plan_view is not None:
            self._preview.max = math.ceil(100.0 * page.plan_view.duration) / 100.0
        self.plan_button.disabled = not page.can_plan
        self._execute.disabled = not page.can_execute
        put(self._progress, round(100.0 * page.progress, 1))
        has_plan = page.plan_is_current
        self._preview.disabled = not has_plan
        grey(self._play, not has_plan)
        self._preview_time.show(page.preview_time if has_plan else 0.0)
        self._now.content = board(
            "plot",
            t=round(page.preview_time, 2) if has_plan else None,
            plots=plots,
            seek=uuid_of(self._preview) if has_plan else None,
        )
        for field, cap in zip(self._caps_deg, page.caps, strict=True):
            field.show(to_deg(cap))
        self._sweeps.show(page.sweeps)
