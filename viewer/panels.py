"""The panels: state and Stop on the left, planning on the right, plots at the bottom.

Stop is the only thing to press in its panel. viser sends at most one message per panel every
50 ms and the last one wins, so in company a click could be lost.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
import viser

from so101_motion.config import SPEED_RANGE_DEG
from so101_motion.geometry import Array
from so101_motion.gripper import JAW_CLOSED, JAW_OPEN
from so101_motion.named_poses import POSES
from so101_motion.planning.plan import Plan
from so101_motion.state import ARM_JOINTS, JointState
from so101_motion.units import to_deg, to_m, to_mm, to_rad

from . import markup, words
from .desk import Desk
from .fields import Field, put
from .markup import Bar
from .plots import PlanPlots
from .screen import Screen
from .view_model import ViewModel

_LEFT_WIDTH = 290
_PLOT_SIZE = (520, 262)
_MARGIN = 12


class StatePanel:
    """What the arm is doing, where its joints stand, and Stop.

    Args:
        gui: Where to make it.
        title: Which arm this is.
        lower: Lower joint limits, shape (5,), [rad].
        upper: Upper joint limits, shape (5,), [rad].
        stops: What Stop calls, each in a thread of its own: they wait for rest.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        *,
        title: str,
        lower: Array,
        upper: Array,
        stops: tuple[Callable[[], None], ...],
    ) -> None:
        self._title = title
        self._lower_deg, self._upper_deg = to_deg(lower), to_deg(upper)
        panel = gui.add_panel()
        with panel.add_tab("Arm", viser.Icon.ROBOT):
            self._state = gui.add_html("")
            button = gui.add_button(
                "STOP", color="red", icon=viser.Icon.HAND_STOP, hint="Space or Escape does the same"
            )
            self._joints = gui.add_html("")
        panel.dock_left()
        panel.set_width(_LEFT_WIDTH)
        icon = viser.Icon.HAND_STOP
        keys = (
            gui.add_command("Stop the arm (Space)", hotkey="space", icon=icon),
            gui.add_command("Stop the arm (Escape)", hotkey="escape", icon=icon),
        )
        for stop in stops:
            button.on_click(_ignoring_event(stop))
            for command in keys:
                command.on_trigger(_ignoring_event(stop))

    def show(self, state: JointState) -> None:
        """Tell ``state``."""
        self._state.content = markup.headline(words.mode(state), self._title)
        self._joints.content = markup.bars(self._bars(state))

    def _bars(self, state: JointState) -> list[Bar]:
        bars = [
            Bar(name=joint, value=float(value), lower=lower, upper=upper, unit="°")
            for joint, value, lower, upper in zip(
                ARM_JOINTS, to_deg(state.q), self._lower_deg, self._upper_deg, strict=True
            )
        ]
        opened = 100.0 * (state.q_jaw - JAW_CLOSED) / (JAW_OPEN - JAW_CLOSED)
        jaw = Bar(name="gripper", value=opened, lower=0.0, upper=100.0, unit="%", warns=False)
        return [*bars, jaw]


class PlanPanel:
    """Target, speed, Plan, preview, Execute, gripper; and the plots of the newest plan.

    Args:
        desk: Where to make it.
        page: What the buttons act on.
    """

    def __init__(self, desk: Desk, page: ViewModel) -> None:
        self._page, self._desk = page, desk
        gui = desk.gui
        with desk.tabs.add_tab("Move", viser.Icon.ROUTE):
            self._add_target(gui)
            self._add_plan(gui)
            self._add_jaw(gui)
        self._plots_panel = gui.add_panel()
        self._plots = PlanPlots(gui, self._plots_panel)
        width, height = _PLOT_SIZE
        self._plots_panel.float(x=_MARGIN, y=-_MARGIN, width=width, height=height)
        self._plots_panel.minimize()
        self._shown: Plan | None = None

    def _add_target(self, gui: viser.GuiApi) -> None:
        self._sentence = gui.add_html("")
        target = gui.add_vector3("Target (mm)", (0.0, 0.0, 0.0), step=1.0)
        target.precision = 1
        self._target_mm = Field(
            target,
            lambda value: self._page.aim_at(to_m(np.array(value))),
            self._desk,
            shown=_tenths,
        )
        poses = gui.add_button_group("Pose", tuple(pose.name for pose in POSES))
        self._desk.on_choice(poses, self._choose)

    def _add_plan(self, gui: viser.GuiApi) -> None:
        slowest, fastest = (round(speed) for speed in SPEED_RANGE_DEG)
        self._speed_deg = Field(
            gui.add_slider("Speed (°/s)", slowest, fastest, 1, slowest),
            lambda value: self._page.set_speed(to_rad(value)),
            self._desk,
            shown=round,
        )
        self._plan = gui.add_button("Plan", icon=viser.Icon.ROUTE)
        self._desk.on_press(self._plan, self._page.plan)
        self._facts = gui.add_html("", visible=False)
        self._preview = gui.add_slider("Preview (s)", 0.0, 1.0, 0.01, 0.0, disabled=True)
        self._preview_time = Field(
            self._preview, self._page.preview, self._desk, shown=lambda t: round(t, 2)
        )
        self._execute = gui.add_button(
            "Execute", icon=viser.Icon.PLAYER_PLAY, color="green", disabled=True
        )
        self._desk.on_press(self._execute, self._page.execute)
        self._progress = gui.add_progress_bar(0.0, color="green")

    def _add_jaw(self, gui: viser.GuiApi) -> None:
        jaw = gui.add_button_group(
            "Gripper", ("open", "close"), hint="Moves at once, without a plan"
        )
        self._desk.on_choice(jaw, lambda name: self._page.move_jaw(1.0 if name == "open" else 0.0))

    def show(self, screen: Screen) -> None:
        """Tell ``screen``; viser sends only what differs."""
        self._sentence.content = markup.sentence(screen.sentence)
        self._target_mm.show(to_mm(screen.aim.p_base))
        self._speed_deg.show(to_deg(screen.speed))
        self._plan.disabled = not screen.can_plan
        self._execute.disabled = not screen.can_execute
        self._preview.disabled = not screen.plan_is_current
        put(self._progress, round(100.0 * screen.progress, 1))
        if screen.plan is not None and screen.plan is not self._shown:
            self._show_plan(screen.plan)
        if screen.plan_is_current:
            self._preview_time.show(screen.preview_time)

    def _show_plan(self, plan: Plan) -> None:
        if self._shown is None:
            self._plots_panel.expand()
        self._shown = plan
        self._plots.show(plan)
        self._facts.content = markup.facts(words.plan_facts(plan))
        self._facts.visible = True
        self._preview.max = math.ceil(100.0 * plan.trajectory.duration) / 100.0

    def _choose(self, name: str) -> None:
        pose = next(pose for pose in POSES if pose.name == name)
        self._page.aim_at_joints(pose.q)


def _tenths(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(round(float(value), 1) + 0.0 for value in values)


def _ignoring_event(call: Callable[[], None]) -> Callable[[object], None]:
    def handler(_event: object) -> None:
        call()

    return handler
