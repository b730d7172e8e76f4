"""The panels: state and Stop on the left, planning on the right, plots at the bottom.

Stop is the only thing to press in its panel. viser sends at most one message per panel every
50 ms and the last one wins, so in company a click could be lost.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import partial

import numpy as np
import viser

from so101_motion.config import ACCELERATION_RANGE_DEG, SPEED_RANGE_DEG
from so101_motion.geometry import Array
from so101_motion.gripper import JAW_CLOSED, JAW_OPEN
from so101_motion.modes import Mode
from so101_motion.named_poses import POSES
from so101_motion.state import ARM_JOINTS, JointState
from so101_motion.units import to_deg, to_m, to_mm, to_rad

from . import markup, words
from .aim import FRAMES
from .desk import Desk
from .fields import Field, put
from .keys import WORDS
from .markup import Bar
from .playback import RATES
from .plots import PlanPlots
from .pose_folder import PoseFolder
from .poses import PoseShelf
from .screen import PlanSight, Screen
from .tracking import Tracking
from .view_model import ViewModel

_LEFT_WIDTH = 290
_PLOT_SIZE = (520, 262)
_MARGIN = 12

_FRAME_NAMES = {frame: frame.replace("_", " ") for frame in FRAMES}
_RATE_NAMES = {f"{rate:g}×": rate for rate in RATES}
_ROUNDING = 1e-6  # 110 degrees came in as a float in radians

_HERE = "here"
"""Beside the named poses: where the arm is."""


class StatePanel:
    """What the arm is doing, where its joints stand, and Stop.

    Args:
        gui: Where to make it.
        title: Which arm this is.
        stops: What Stop calls, each in a thread of its own: they wait for rest.

    Attributes:
        panel: The panel.
        stop_widgets: The button and the keys.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        *,
        title: str,
        stops: tuple[Callable[[], None], ...],
    ) -> None:
        self._title = title
        panel = gui.add_panel()
        with panel.add_tab("Arm", viser.Icon.ROBOT):
            self._state = gui.add_html("")
            button = gui.add_button(
                "STOP", color="red", icon=viser.Icon.HAND_STOP, hint="Space or Escape does the same"
            )
            self._joints = gui.add_html("")
            gui.add_html(markup.small(WORDS))
        panel.dock_left()
        panel.set_width(_LEFT_WIDTH)
        self._on_phones = gui.add_html("", order=-20.0)
        self.panel = panel
        icon = viser.Icon.HAND_STOP
        keys = (
            gui.add_command("Stop the arm (Space)", hotkey="space", icon=icon),
            gui.add_command("Stop the arm (Escape)", hotkey="escape", icon=icon),
        )
        self.stop_widgets = (button, *keys)
        for stop in stops:
            button.on_click(_ignoring_event(stop))
            for command in keys:
                command.on_trigger(_ignoring_event(stop))

    def show(self, state: JointState, bounds: tuple[Array, Array], *, lost: bool = False) -> None:
        """Tell ``state``, the joints between the smallest and the largest angles [rad].

        Args:
            state: How the arm is, or was last.
            bounds: Smallest and largest angles, shapes (5,), [rad].
            lost: Whether the arm cannot be reached.
        """
        mode = words.mode(state, lost=lost)
        self._state.content = markup.headline(mode, self._title)
        self._on_phones.content = markup.on_phones(mode, self._title)
        self._joints.content = markup.bars(_bars(state, bounds))


class PlanPanel:
    """Target, caps, Plan, preview, Execute, gripper; and the plots of the newest plan.

    Args:
        desk: Where to make it.
        page: What the buttons act on.
        poses: The user's own poses.
    """

    def __init__(self, desk: Desk, page: ViewModel, poses: PoseShelf) -> None:
        self._page, self._desk = page, desk
        self._range: tuple[Array, Array] | None = None
        gui = desk.gui
        with desk.tabs.add_tab("Move", viser.Icon.ROUTE):
            self._sentence = gui.add_html("")
            self._add_target(gui)
            self._own_poses = PoseFolder(desk, poses)
            self._add_plan(gui)
            self._add_jaw(gui)
        self._plots_panel = gui.add_panel()
        self._plots = PlanPlots(gui, self._plots_panel)
        width, height = _PLOT_SIZE
        self._plots_panel.float(x=_MARGIN, y=-_MARGIN, width=width, height=height)
        self._plots_panel.minimize()
        self._shown: PlanSight | None = None
        self._tracking: Tracking | None = None

    def _add_target(self, gui: viser.GuiApi) -> None:
        target = gui.add_vector3("Target (mm)", (0.0, 0.0, 0.0), step=1.0)
        target.precision = 1
        self._target_mm = Field(
            target,
            lambda value: self._page.aim_at(to_m(np.array(value))),
            self._desk,
            shown=_tenths,
        )
        self._frame = Field(
            gui.add_dropdown("Target for", tuple(_FRAME_NAMES.values())),
            lambda name: self._page.aim_with(name.replace(" ", "_")),
            self._desk,
            shown=str,
        )
        poses = gui.add_button_group("Pose", (*(pose.name for pose in POSES), _HERE))
        self._desk.on_choice(poses, self._choose)
        with gui.add_folder("Joints (°)", expand_by_default=False):
            self._sliders = [gui.add_slider(name, -1.0, 1.0, 0.1, 0.0) for name in ARM_JOINTS]
        self._joints_deg = [
            Field(slider, partial(self._turn, i), self._desk, shown=_tenth)
            for i, slider in enumerate(self._sliders)
        ]

    def _turn(self, i: int, angle_deg: float) -> None:
        self._page.aim_at_joint(i, to_rad(angle_deg))

    def _add_plan(self, gui: viser.GuiApi) -> None:
        self._speed_deg = self._add_cap(gui, "Speed (°/s)", SPEED_RANGE_DEG, self._page.set_speed)
        self._acceleration_deg = self._add_cap(
            gui, "Accel. (°/s²)", ACCELERATION_RANGE_DEG, self._page.set_acceleration
        )
        self._plan = gui.add_button("Plan", icon=viser.Icon.ROUTE)
        self._desk.on_press(self._plan, self._page.plan)
        self._preview = gui.add_slider("Preview (s)", 0.0, 1.0, 0.01, 0.0, visible=False)
        self._preview_time = Field(
            self._preview, self._page.preview, self._desk, shown=lambda t: round(t, 2)
        )
        self._play = gui.add_button_group(
            "Play",
            tuple(_RATE_NAMES),
            visible=False,
            hint="The ghost alone, at this share of the arm's pace; again to let it stand",
        )
        self._desk.on_choice(self._play, lambda name: self._page.play(_RATE_NAMES[name]))
        self._execute = gui.add_button(
            "Execute", icon=viser.Icon.PLAYER_PLAY, color="green", disabled=True
        )
        self._desk.on_press(self._execute, self._page.execute)
        self._progress = gui.add_progress_bar(0.0, color="green")
        self._facts = gui.add_html("", visible=False)
        self._sweep = gui.add_checkbox("Swept motion", True, visible=False)
        self._sweeps = Field(self._sweep, self._page.show_sweep, self._desk, shown=bool)

    def _add_cap(
        self,
        gui: viser.GuiApi,
        label: str,
        range_deg: tuple[float, float],
        command: Callable[[float], None],
    ) -> Field:
        slowest, fastest = (round(end) for end in range_deg)
        return Field(
            gui.add_slider(label, slowest, fastest, 1, slowest),
            lambda value: command(to_rad(value)),
            self._desk,
            shown=round,
        )

    def _add_jaw(self, gui: viser.GuiApi) -> None:
        self._jaw = gui.add_button_group(
            "Gripper", ("open", "close"), hint="Moves at once, without a plan"
        )
        self._desk.on_choice(self._jaw, lambda name: self._page.move_jaw(float(name == "open")))

    def show(self, screen: Screen) -> None:
        """Tell ``screen``; viser sends only what differs."""
        self._sentence.content = markup.sentence(screen.sentence)
        self._jaw.visible = screen.state.mode not in (Mode.LIMP, Mode.FAULT, Mode.CALIBRATING)
        self._show_target(screen)
        self._own_poses.show()
        self._speed_deg.show(to_deg(screen.speed))
        self._acceleration_deg.show(to_deg(screen.acceleration))
        self._plan.disabled = not screen.can_plan
        self._execute.disabled = not screen.can_execute
        put(self._progress, round(100.0 * screen.progress, 1))
        if screen.plan is not None and screen.plan is not self._shown:
            self._show_plan(screen.plan, screen.range)
        if screen.tracking is not None and screen.tracking is not self._tracking:
            self._tracking = screen.tracking
            self._plots.show_tracking(screen.tracking)
        for widget in (self._preview, self._play, self._facts, self._sweep):
            widget.visible = screen.plan_is_current
        if screen.plan_is_current:
            self._preview_time.show(screen.preview_time)
        self._sweeps.show(screen.sweeps)

    def _show_target(self, screen: Screen) -> None:
        self._target_mm.show(to_mm(screen.aim.p_base))
        self._frame.show(_FRAME_NAMES[screen.aim.frame])
        if screen.range is not self._range:
            self._range = screen.range
            for slider, lower, upper in zip(self._sliders, *screen.range, strict=True):
                slider.min = math.ceil(10.0 * to_deg(lower) - _ROUNDING) / 10.0
                slider.max = math.floor(10.0 * to_deg(upper) + _ROUNDING) / 10.0
        for field, angle in zip(self._joints_deg, screen.aim.q, strict=True):
            field.show(to_deg(float(angle)))

    def _show_plan(self, seen: PlanSight, bounds: tuple[Array, Array]) -> None:
        if self._shown is None:
            self._plots_panel.expand()
        self._shown = seen
        self._plots.show(seen.plan, bounds)
        self._facts.content = markup.facts(words.plan_facts(seen))
        self._preview.max = math.ceil(100.0 * seen.plan.duration) / 100.0

    def _choose(self, name: str) -> None:
        if name == _HERE:
            self._page.aim_here()
        else:
            self._page.aim_at_joints(next(pose for pose in POSES if pose.name == name).q)


def _bars(state: JointState, bounds: tuple[Array, Array]) -> list[Bar]:
    bars = [
        Bar(name=joint, value=float(value), lower=float(lower), upper=float(upper), unit="°")
        for joint, value, lower, upper in zip(
            ARM_JOINTS, to_deg(state.q), *(to_deg(end) for end in bounds), strict=True
        )
    ]
    opened = 100.0 * (state.q_jaw - JAW_CLOSED) / (JAW_OPEN - JAW_CLOSED)
    jaw = Bar(name="gripper", value=opened, lower=0.0, upper=100.0, unit="%", warns=False)
    return [*bars, jaw]


def _tenth(value: float) -> float:
    return round(float(value), 1) + 0.0


def _tenths(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(_tenth(value) for value in values)


def _ignoring_event(call: Callable[[], None]) -> Callable[[object], None]:
    def handler(_event: object) -> None:
        call()

    return handler
