"""The Move tab: targets, Plan, preview, Execute, grippers; and the plots of the newest plan."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import viser

from so101_motion.arm.gripper import GENTLEST
from so101_motion.common.attributes import ACCELERATION_RANGE_DEG, SPEED_RANGE_DEG
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.named_poses import POSES
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_m

from ..page import markup, texts, units
from ..page.bar import board, greyed, uuid_of
from ..page.history import SavedFiles
from ..page.page_context import PageContext
from ..page.plan_view import RATES, CommonPlan
from ..page.shared_fields import SharedField, TimeFields, UndoButtons, grey, percent_slider, put
from ..page.target_editor import DIRECTIONS
from ..page.target_ik import FRAMES
from ..view_model import MoveModel, ViewModel
from .plots import PlanPlots
from .poses import PoseFolder, PoseList

_LINES = 7  # lines reserved for six figures, and a clearance with long names
STEPS_MM = (1.0, 10.0, 50.0)  # how far a nudge moves the target; chosen
SELECTS = "selects"  # what a click in the picture does unless it sets the target

_FRAME = units.Unit(lambda frame: frame.replace("_", " "), lambda name: name.replace(" ", "_"))
_ROUNDING = 1e-6  # 110 degrees, converted to radians and back, is not exactly 110
_REACHED = "The target can be reached as it is."
_OFF = (Mode.LIMP, Mode.FAULT, Mode.CALIBRATING)


class PlanPanel:
    """The Move tab, and the panel with the plots of the newest plan.

    What is used for every motion comes first, so that Plan and Execute are seen on a phone without
    scrolling. ``on_click`` is called with what clicks in the picture do, ``SELECTS`` or another.
    """

    def __init__(
        self,
        context: PageContext,
        model: MoveModel,
        poses: PoseList | None,
        *,
        on_click: Callable[[str], None],
    ) -> None:
        self._context, self._model = context, model
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
        self._add_buttons()
        arms = gui.add_tab_group()
        for name, target in self._targets.items():
            with arms.add_tab(name):
                target.add_target()
                target.add_nudge()
                target.add_jaw()
                with gui.add_folder("More", expand_by_default=False):
                    target.add_choices()
        self._add_plan()

    def _add_one(self, page: ViewModel, poses: PoseList, on_click: Callable[[str], None]) -> None:
        context, gui, target = self._context, self._context.gui, self._targets[""]
        target.add_target()
        self._add_buttons()
        target.add_nudge()
        self._back_out = context.button(
            "Back out slowly",
            self._model.plan_back_out,
            visible=False,
            hint="Plans a slow straight motion out of the contact; Execute runs it. In a surface"
            " whose inside is not known it may lead deeper.",
        )
        self._add_plan()
        replan = gui.add_checkbox(
            "Plan again while moving",
            False,
            hint="When an object on the World tab moves, the arm goes around it without a stop if"
            " it can, and stops if it cannot.",
        )
        self._replans = SharedField(replan, partial(setattr, page, "replans"), context)
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
        target.add_choices(poses.saved_files)
        self._own_poses = PoseFolder(context, poses)

    def _add_buttons(self) -> None:
        """Plan and Execute. The key P plans; no key executes, so that people look at the plan."""
        context, model = self._context, self._model
        self.plan_button = context.button("Plan", model.plan, icon=viser.Icon.ROUTE)
        self._execute = context.button(
            "Execute", model.execute, icon=viser.Icon.PLAYER_PLAY, color="green", disabled=True
        )
        self._progress = context.gui.add_progress_bar(0.0, color="green")

    def _add_plan(self) -> None:
        context, gui, model = self._context, self._context.gui, self._model
        hint = "Plays only the ghost, at this fraction of the arm's speed; press again to pause"
        self._preview = TimeFields(context, "Preview (s)", model.playback, RATES, hint)
        self._facts = gui.add_html("")
        self._now = gui.add_html("", visible=False)
        self._caps = []
        for label, least_deg, most, command in (
            ("Speed (°/s)", SPEED_RANGE_DEG[0], model.most[0], model.set_speed),
            ("Accel. (°/s²)", ACCELERATION_RANGE_DEG[0], model.most[1], model.set_acceleration),
        ):
            least, most_deg = round(least_deg), round(to_deg(most))
            slider = gui.add_slider(label, least, most_deg, 1, least)
            self._caps.append(SharedField(slider, command, context, units.WHOLE_DEGREES))
        sweep = gui.add_checkbox("Swept motion", True)
        self._sweeps = SharedField(sweep, model.show_sweep, context)

    def show(self) -> None:
        model = self._model
        self._sentence.content = self._context.sentence(model.sentence)
        for target in self._targets.values():
            target.show()
        if self._own_poses is not None:
            self._own_poses.show()
        self._plots.show(model)
        self._show_plan()
        one = model.arms.get("")
        if one is None:
            common = model.common_plan if model.plan_is_current else None
            self._facts.content = markup.facts(plan_facts(common))
        else:
            self._back_out.visible = one.can_back_out
            self._replans.show(one.replans)
            plan = one.plan_view if one.plan_is_current else None
            figures = texts.NO_FACTS if plan is None else texts.plan_facts(plan)
            touches = plan is not None and plan.closest.distance < 0.0
            bad = ("Clearance",) if touches else ()
            self._facts.content = markup.facts(figures, lines=_LINES, bad=bad)

    def _show_plan(self) -> None:
        model = self._model
        plan = model.common_plan if model.plan_is_current else None
        self.plan_button.disabled = not model.can_plan
        self._execute.disabled = not model.can_execute
        put(self._progress, round(100.0 * model.progress, 1))
        self._preview.show(None if plan is None else plan.duration, model.playback.t)
        self._now.content = board(
            "plot",
            t=round(model.playback.t, 2) if plan else None,
            plots=self._plots.uuids,
            seek=uuid_of(self._preview.slider) if plan else None,
        )
        for field, cap in zip(self._caps, model.caps, strict=True):
            field.show(cap)
        self._sweeps.show(model.sweeps)


def plan_facts(plan: CommonPlan | None) -> tuple[tuple[str, str], ...]:
    if plan is None:
        return (("Duration", "–"),)
    pairs = (texts.between(each.first, each.second, each.least) for each in plan.clearances)
    reports = {name: each.report for name, each in plan.plans.items()}
    remarks = [(name, each.for_others or each.short_of_drive) for name, each in reports.items()]
    return (("Duration", f"{plan.duration:.2f} s"), *(each for each in remarks if each[1]), *pairs)


class TargetControls:
    """Adds widgets for the target of one arm where its methods are called.

    Nothing comes and goes: what cannot be used is grey, so no button takes another's place.
    """

    def __init__(self, context: PageContext, page: ViewModel) -> None:
        self._context, self._page = context, page
        self._range: tuple[Array, Array] | None = None
        self._step_mm = STEPS_MM[1]

    def add_target(self) -> None:
        gui = self._context.gui
        target = gui.add_vector3("Target (mm)", (0.0, 0.0, 0.0), step=1.0)
        target.precision = 1
        self._target = SharedField(target, self._page.set_target_point, self._context, units.MM)
        poses = {pose.name: partial(self._page.set_target_joints, pose.q) for pose in POSES}
        others = {"here": self._page.set_target_here, "nearest": self._page.take_nearest}
        hint = "here: where the arm is; nearest: the nearest place that is reached without contact"
        self._poses = self._context.buttons("Pose", {**poses, **others}, hint)
        self._told = gui.add_html("", visible=False)

    def add_nudge(self) -> None:
        context = self._context
        sizes = {f"{mm:g}": partial(setattr, self, "_step_mm", mm) for mm in STEPS_MM}
        context.buttons("Step (mm)", sizes, "How far a nudge moves the target")
        ways = {
            f"{sign}{axis}": partial(self._nudge, k, way)
            for k, axis in enumerate("XYZ")
            for sign, way in (("−", -1.0), ("+", 1.0))
        }
        context.buttons("Nudge", ways, "Moves the target; the arm waits for Plan and Execute")
        self._chosen_step = context.gui.add_html("")

    def _nudge(self, axis: int, way: float) -> None:
        p_base = np.array(self._page.target.p_base)
        p_base[axis] += way * to_m(self._step_mm)
        self._page.set_target_point(p_base)

    def add_choices(self, *also: SavedFiles) -> None:
        """Add what chooses the target; its undo goes through the changes of ``also``, too."""
        context, gui, page = self._context, self._context.gui, self._page
        self._undo = UndoButtons(context, page.history, *also)
        frame = gui.add_dropdown("Target for", tuple(map(_FRAME.shown, FRAMES)))
        self._frame = SharedField(frame, page.set_target_frame, context, _FRAME)
        with gui.add_folder("Direction", expand_by_default=False):
            kind = gui.add_dropdown(
                "Keeps", DIRECTIONS, hint="How much of the gripper's direction the target fixes"
            )
            tilt = gui.add_slider("Tilt (°)", -90, 90, 1, 0, hint="-90 is straight down")
            roll = gui.add_slider("Roll (°)", -180, 180, 1, 0)
        self._kind = SharedField(kind, page.set_direction, context)
        self._tilt = SharedField(tilt, page.set_tilt, context, units.WHOLE_DEGREES)
        self._roll = SharedField(roll, page.set_roll, context, units.WHOLE_DEGREES)
        with gui.add_folder("Joints (°)", expand_by_default=False):
            self._sliders = [gui.add_slider(name, -1.0, 1.0, 0.1, 0.0) for name in ARM_JOINTS]
        self._joints = [
            SharedField(slider, partial(page.set_target_joint, i), context, units.DEGREES)
            for i, slider in enumerate(self._sliders)
        ]

    def add_jaw(self) -> None:
        """The jaw, which moves at once."""
        gui, move = self._context.gui, self._page.move_jaw
        self._jaw = self._context.buttons(
            "Gripper",
            {"open": partial(move, 1.0), "close": partial(move, 0.0)},
            "Moves at once, without a plan",
        )
        hint = "The jaw follows at once, without a plan"
        self._opened = percent_slider(self._context, "Opening (%)", move, hint)
        hint = "Share of the force that the servo can hold without getting hot"
        self._force = percent_slider(
            self._context, "Grip force (%)", self._page.set_force, hint, GENTLEST
        )
        self._grip = gui.add_html("")

    def show(self) -> None:
        page, state = self._page, self._page.state
        is_off = state.mode in _OFF
        self._opened.widget.disabled = is_off
        grey(self._jaw, is_off)
        if not state.jaw_moving:
            self._opened.show(texts.aperture(state.q_jaw_ref))
        self._grip.content = markup.small(texts.grip(state, holds=page.gripper.is_holding))
        self._force.show(page.force)
        why_not = {"nearest": _REACHED} if page.target.problem is None else {}
        self._told.content = greyed(self._poses, why_not)
        self._undo.show()
        self._target.show(page.target.p_base)
        self._chosen_step.content = f'<i data-chosen="{self._step_mm:g}"></i>'
        self._kind.show(page.kind)
        self._tilt.show(page.direction.tilt)
        self._roll.show(page.direction.roll or 0.0)
        self._frame.show(page.target.frame)
        if page.arm.range is not self._range:
            self._range = page.arm.range
            for slider, lower, upper in zip(self._sliders, *self._range, strict=True):
                slider.min = math.ceil(10.0 * to_deg(lower) - _ROUNDING) / 10.0
                slider.max = math.floor(10.0 * to_deg(upper) + _ROUNDING) / 10.0
        for field, angle in zip(self._joints, page.target.q, strict=True):
            field.show(float(angle))
