"""The Move tab: target, Plan, preview, Execute, gripper; and the plots of the newest plan."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import viser

from so101_motion.arm.gripper import GENTLEST
from so101_motion.common.attributes import ACCELERATION_RANGE_DEG, SPEED_RANGE_DEG
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.named_poses import POSES
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_m, to_mm, to_rad

from ..page import markup, texts
from ..page.bar import board, uuid_of
from ..page.page_context import ArmContext
from ..page.playback import RATES
from ..page.screen_state import PlanView, Screen
from ..page.shared_fields import SharedField, grey, put, tenth, tenths
from ..page.target_editor import DIRECTIONS
from ..page.target_ik import FRAMES
from ..page.tracking import Tracking
from ..view_model import ViewModel
from .comparison import Comparison
from .plots import PlanPlots
from .pose_folder import PoseFolder
from .poses import PoseList

_PLOT_SIZE = (390, 305)  # between the panels of the narrowest window that has both
_MARGIN = 12

_FRAME_NAMES = {frame: frame.replace("_", " ") for frame in FRAMES}
_RATE_NAMES = {f"{rate:g}×": rate for rate in RATES}
_ROUNDING = 1e-6  # 110 degrees came in as a float in radians

_NEAREST = "take the nearest"

SELECTS, AIMS, MEASURES = "selects", "sets the target", "measures"
CLICKS = (SELECTS, AIMS, MEASURES)
"""What a click in the picture does."""

_HERE = "here"
"""Among the named poses: where the arm is now."""


class PlanPanel:
    """The Move tab, and the panel with the plots of the newest plan.

    Args:
        on_click: Told what clicks in the picture do, one of ``CLICKS``.

    What is used for every motion comes first, so that Plan and Execute are seen on a phone without
    scrolling. Nothing comes and goes: what cannot be used is grey, so no button takes another's
    place.

    Attributes:
        plan_button: What plans.
    """

    def __init__(
        self,
        context: ArmContext,
        page: ViewModel,
        poses: PoseList,
        *,
        on_click: Callable[[str], None],
    ) -> None:
        self._page, self._context, self._on_click = page, context, on_click
        self._range: tuple[Array, Array] | None = None
        gui = context.gui
        with context.tabs.add_tab("Move"):
            self._sentence = gui.add_html("")
            self._add_target(gui)
            self._add_plan(gui)
            self._add_jaw(gui)
            self._add_choices(gui)
            self._own_poses = PoseFolder(context, poses)
        self._plots_panel = gui.add_panel()
        self._plots = PlanPlots(gui, self._plots_panel)
        width, height = _PLOT_SIZE
        self._plots_panel.float(x=_MARGIN, y=-_MARGIN, width=width, height=height)
        self._plots_panel.minimize()
        self._shown: PlanView | None = None
        self._tracking: Tracking | None = None

    def _add_target(self, gui: viser.GuiApi) -> None:
        target = gui.add_vector3("Target (mm)", (0.0, 0.0, 0.0), step=1.0)
        target.precision = 1
        self._target_mm = SharedField(
            target,
            lambda value: self._page.set_target_point(to_m(np.array(value))),
            self._context,
            shown=tenths,
        )
        self._nearest = gui.add_button_group(
            "Out of reach",
            (_NEAREST,),
            hint="Sets the target to where the ghost stands, the nearest place within reach",
        )
        self._context.on_choice(self._nearest, lambda _name: self._page.take_nearest())
        poses = gui.add_button_group("Pose", (*(pose.name for pose in POSES), _HERE))
        self._context.on_choice(poses, self._choose)

    def _add_choices(self, gui: viser.GuiApi) -> None:
        gui.add_divider()
        click = gui.add_dropdown(
            "A click",
            CLICKS,
            hint="On the table or an object: the target 20 mm above it, or two points to measure",
        )
        self._context.on_entry(click, self._on_click)
        self._history = gui.add_button_group("Target", ("undo", "redo"))
        self._context.on_choice(
            self._history, lambda name: self._page.undo() if name == "undo" else self._page.redo()
        )
        self._frame = SharedField(
            gui.add_dropdown("Target for", tuple(_FRAME_NAMES.values())),
            lambda name: self._page.set_target_frame(name.replace(" ", "_")),
            self._context,
            shown=str,
        )
        with gui.add_folder("Direction", expand_by_default=False):
            kind = gui.add_dropdown(
                "Keeps", DIRECTIONS, hint="What of the gripper's direction a target keeps"
            )
            tilt = gui.add_slider("Tilt (°)", -90, 90, 1, 0, hint="-90 is straight down")
            roll = gui.add_slider("Roll (°)", -180, 180, 1, 0)
        self._kind = SharedField(kind, self._page.set_direction, self._context, shown=str)
        self._tilt = self._angle(tilt, self._page.set_tilt)
        self._roll = self._angle(roll, self._page.set_roll)
        with gui.add_folder("Joints (°)", expand_by_default=False):
            self._sliders = [gui.add_slider(name, -1.0, 1.0, 0.1, 0.0) for name in ARM_JOINTS]
        self._joints_deg = [
            SharedField(slider, partial(self._turn, i), self._context, shown=tenth)
            for i, slider in enumerate(self._sliders)
        ]

    def _angle(self, slider: Any, command: Callable[[float], None]) -> SharedField:
        return SharedField(
            slider, lambda degrees: command(to_rad(degrees)), self._context, shown=round
        )

    def _turn(self, i: int, angle_deg: float) -> None:
        self._page.set_target_joint(i, to_rad(angle_deg))

    def _add_plan(self, gui: viser.GuiApi) -> None:
        # The key P presses it, and none executes: what moves the arm is pressed after looking.
        self.plan_button = gui.add_button("Plan", icon=viser.Icon.ROUTE)
        self._context.on_press(self.plan_button, self._page.plan)
        self._execute = gui.add_button(
            "Execute", icon=viser.Icon.PLAYER_PLAY, color="green", disabled=True
        )
        self._context.on_press(self._execute, self._page.execute)
        self._progress = gui.add_progress_bar(0.0, color="green")
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
        self._facts = gui.add_html(markup.facts(texts.NO_FACTS))
        self._comparison = Comparison(self._context)
        self._now = gui.add_html("", visible=False)
        self._speed_deg = self._add_cap(gui, "Speed (°/s)", SPEED_RANGE_DEG, self._page.set_speed)
        self._acceleration_deg = self._add_cap(
            gui, "Accel. (°/s²)", ACCELERATION_RANGE_DEG, self._page.set_acceleration
        )
        sweep = gui.add_checkbox("Swept motion", True)
        self._sweeps = SharedField(sweep, self._page.show_sweep, self._context, shown=bool)

    def _add_cap(
        self,
        gui: viser.GuiApi,
        label: str,
        range_deg: tuple[float, float],
        command: Callable[[float], None],
    ) -> SharedField:
        slowest, fastest = (round(end) for end in range_deg)
        return SharedField(
            gui.add_slider(label, slowest, fastest, 1, slowest),
            lambda value: command(to_rad(value)),
            self._context,
            shown=round,
        )

    def _add_jaw(self, gui: viser.GuiApi) -> None:
        gui.add_divider()
        self._jaw = gui.add_button_group(
            "Gripper", ("open", "close"), hint="Moves at once, without a plan"
        )
        self._context.on_choice(self._jaw, lambda name: self._page.move_jaw(float(name == "open")))
        self._opening = gui.add_slider(
            "Opening (%)", 0, 100, 1, 0, hint="The jaw follows at once, without a plan"
        )
        self._opened = SharedField(
            self._opening,
            lambda percent: self._page.move_jaw(percent / 100.0),
            self._context,
            shown=round,
        )
        force = gui.add_slider(
            "Grip force (%)",
            round(100.0 * GENTLEST),
            100,
            1,
            100,
            hint="Of the force that the servo can keep up without getting hot",
            visible=False,
        )
        self._force = SharedField(
            force, lambda percent: self._page.set_force(percent / 100.0), self._context, shown=round
        )
        self._grip = gui.add_html("")

    def show(self, screen: Screen) -> None:
        """Show ``screen``; viser sends only what differs."""
        self._sentence.content = markup.sentence(screen.sentence)
        is_off = screen.state.mode in (
            Mode.LIMP,
            Mode.FAULT,
            Mode.CALIBRATING,
        )
        self._opening.disabled = is_off
        grey(self._jaw, is_off)
        if not screen.state.jaw_moving:
            self._opened.show(100.0 * texts.aperture(screen.state.q_jaw_ref))
        self._grip.content = markup.small(texts.grip(screen))
        self._force.show(None if screen.force is None else 100.0 * screen.force)
        grey(self._nearest, not screen.can_take_nearest)
        grey(self._history, not (screen.can_undo or screen.can_redo))
        self._show_target(screen)
        self._own_poses.show()
        self._speed_deg.show(to_deg(screen.speed))
        self._acceleration_deg.show(to_deg(screen.acceleration))
        self.plan_button.disabled = not screen.can_plan
        self._execute.disabled = not screen.can_execute
        put(self._progress, round(100.0 * screen.progress, 1))
        if screen.plan is not None and screen.plan is not self._shown:
            self._show_plan(screen.plan, screen.range)
        if screen.tracking is not None and screen.tracking is not self._tracking:
            self._tracking = screen.tracking
            self._plots.show_tracking(screen.tracking, screen.tracked)
        has_plan = screen.plan_is_current
        self._plots.name(screen.plan, is_current=has_plan)
        self._preview.disabled = not has_plan
        grey(self._play, not has_plan)
        self._comparison.show(screen.plan if has_plan else None)
        self._facts.content = markup.facts(self._comparison.rows())
        self._preview_time.show(screen.preview_time if has_plan else 0.0)
        self._now.content = board(
            "plot",
            t=round(screen.preview_time, 2) if has_plan else None,
            plots=self._plots.uuids,
            seek=uuid_of(self._preview) if has_plan else None,
        )
        self._sweeps.show(screen.sweeps)

    def _show_target(self, screen: Screen) -> None:
        self._target_mm.show(to_mm(screen.target.p_base))
        self._kind.show(screen.kind)
        self._tilt.show(to_deg(screen.direction.tilt))
        self._roll.show(to_deg(screen.direction.roll or 0.0))
        self._frame.show(_FRAME_NAMES[screen.target.frame])
        if screen.range is not self._range:
            self._range = screen.range
            for slider, lower, upper in zip(self._sliders, *screen.range, strict=True):
                slider.min = math.ceil(10.0 * to_deg(lower) - _ROUNDING) / 10.0
                slider.max = math.floor(10.0 * to_deg(upper) + _ROUNDING) / 10.0
        for field, angle in zip(self._joints_deg, screen.target.q, strict=True):
            field.show(to_deg(float(angle)))

    def _show_plan(self, view: PlanView, bounds: tuple[Array, Array]) -> None:
        if self._shown is None:
            self._plots_panel.expand()
        self._shown = view
        self._plots.show(view.plan, bounds)
        self._preview.max = math.ceil(100.0 * view.plan.duration) / 100.0

    def _choose(self, name: str) -> None:
        if name == _HERE:
            self._page.set_target_here()
        else:
            self._page.set_target_joints(next(pose for pose in POSES if pose.name == name).q)
