"""Widgets that choose a target of an arm, and move its jaw."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from so101_motion.arm.gripper import GENTLEST
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.named_poses import POSES
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_m, to_mm, to_rad

from ..page import markup, texts
from ..page.page_context import PageContext
from ..page.shared_fields import SharedField, UndoButtons, grey, tenth, tenths
from ..page.target_editor import DIRECTIONS
from ..page.target_ik import FRAMES
from ..view_model import ViewModel

_FRAME_NAMES = {frame: frame.replace("_", " ") for frame in FRAMES}
_ROUNDING = 1e-6  # 110 degrees, converted to radians and back, is not exactly 110
_OFF = (Mode.LIMP, Mode.FAULT, Mode.CALIBRATING)


class TargetControls:
    """Adds widgets for the target of one arm where its methods are called.

    Nothing comes and goes: what cannot be used is grey, so no button takes another's place.
    """

    def __init__(self, context: PageContext, page: ViewModel) -> None:
        self._context, self._page = context, page
        self._range: tuple[Array, Array] | None = None

    def add_target(self) -> None:
        """The target point, and named poses."""
        gui = self._context.gui
        target = gui.add_vector3("Target (mm)", (0.0, 0.0, 0.0), step=1.0)
        target.precision = 1
        self._target_mm = SharedField(
            target,
            lambda value: self._page.set_target_point(to_m(np.array(value))),
            self._context,
            shown=tenths,
        )
        self._nearest = self._context.buttons(
            "If unreachable",
            {"take the nearest": self._page.take_nearest},
            "Sets the target to the nearest place that can be reached without contact",
        )
        poses = {pose.name: partial(self._page.set_target_joints, pose.q) for pose in POSES}
        self._context.buttons("Pose", {**poses, "here": self._page.set_target_here})

    def add_choices(self) -> None:
        """The frame of the target, the gripper's direction, single joints, and undo."""
        gui = self._context.gui
        self._history = UndoButtons(self._context, "Target", self._page.history)
        self._frame = SharedField(
            gui.add_dropdown("Target for", tuple(_FRAME_NAMES.values())),
            lambda name: self._page.set_target_frame(name.replace(" ", "_")),
            self._context,
            shown=str,
        )
        with gui.add_folder("Direction", expand_by_default=False):
            kind = gui.add_dropdown(
                "Keeps", DIRECTIONS, hint="How much of the gripper's direction the target fixes"
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

    def add_jaw(self) -> None:
        """The jaw, which moves at once."""
        gui = self._context.gui
        move = self._page.move_jaw
        self._jaw = self._context.buttons(
            "Gripper",
            {"open": partial(move, 1.0), "close": partial(move, 0.0)},
            "Moves at once, without a plan",
        )
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
            hint="Share of the force that the servo can hold without getting hot",
            visible=False,
        )
        self._force = SharedField(
            force, lambda percent: self._page.set_force(percent / 100.0), self._context, shown=round
        )
        self._grip = gui.add_html("")

    def show(self) -> None:
        """Show the target and the jaw; viser sends only what differs."""
        page, state = self._page, self._page.state
        is_off = state.mode in _OFF
        self._opening.disabled = is_off
        grey(self._jaw, is_off)
        if not state.jaw_moving:
            self._opened.show(100.0 * texts.aperture(state.q_jaw_ref))
        self._grip.content = markup.small(texts.grip(state, holds=page.gripper.is_holding))
        self._force.show(None if page.force is None else 100.0 * page.force)
        grey(self._nearest, page.target.problem is None)
        self._history.show()
        self._target_mm.show(to_mm(page.target.p_base))
        self._kind.show(page.kind)
        self._tilt.show(to_deg(page.direction.tilt))
        self._roll.show(to_deg(page.direction.roll or 0.0))
        self._frame.show(_FRAME_NAMES[page.target.frame])
        if page.arm.range is not self._range:
            self._range = page.arm.range
            for slider, lower, upper in zip(self._sliders, *self._range, strict=True):
                slider.min = math.ceil(10.0 * to_deg(lower) - _ROUNDING) / 10.0
                slider.max = math.floor(10.0 * to_deg(upper) + _ROUNDING) / 10.0
        for field, angle in zip(self._joints_deg, page.target.q, strict=True):
            field.show(to_deg(float(angle)))
