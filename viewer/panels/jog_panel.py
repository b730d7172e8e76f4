"""The Jog tab: move joints or tool while a button, a key or a gamepad's stick is held.

``server/front/jog.js`` handles its buttons.
"""

from __future__ import annotations

from functools import partial
from html import escape
from typing import Any

import viser

from so101_motion.common.errors import Interrupted
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_mm
from so101_motion.rig.protocols import RigLike
from so101_motion.viam.client import MachineRig

from ..page import markup, texts
from ..page.bar import uuid_of
from ..page.causes import NextEvent
from ..page.jogging import (
    ARROWS,
    BASE,
    JOINTS,
    MODES,
    SPEEDS,
    TOOL,
    Jogging,
    read_held,
)
from ..page.page_context import PageContext, Part
from ..page.screen_state import Sentence, Tone
from ..view_model import ViewModel
from .plan_panel import STEPS_MM

_OFF = Sentence(
    "Off. Start jogging, then hold a button or its key: the arm moves while you do. For steps of"
    f" {', '.join(f'{mm:g}' for mm in STEPS_MM)} mm: Nudge on the Move tab."
)
_OPENS = Sentence("Starting …")
_ON = Sentence(
    "Hold a button or its key. Gamepad: hold a shoulder button and use the sticks.",
    Tone.GOOD,
)
_ARROWS = Sentence(
    "Drag the target's arrows in the picture: the arm follows while you drag.", Tone.GOOD
)
_FAR = Sentence(
    "The arm of a machine cannot be jogged: over a network the arm may learn too late that you"
    " let go. Plan a motion on the Move tab, or guide the arm by hand."
)
_STOPPED = Sentence("Stopped. Start jogging to go on.")


class JogPart(Part):
    """The widgets of the Jog tab; ``page`` has the target whose arrows can be dragged."""

    def __init__(
        self, context: PageContext, rig: RigLike, page: ViewModel, *, title: str = "Jog"
    ) -> None:
        self._context, self._page, self._arm = context, page, rig.arm
        self.jogging = Jogging(rig, self._wanted)
        self._is_far = isinstance(rig, MachineRig)
        self._mode = MODES[0]
        self._next, self._outcome = NextEvent(rig.arm), self.jogging.outcome
        self._shown: object = None
        gui = context.gui
        with context.tabs.add_tab(title):
            self._sentence = gui.add_html("")
            self._switch = context.button(
                "Start jogging", self._toggle, icon=viser.Icon.HAND_FINGER
            )
            modes = {mode: partial(self._choose, mode) for mode in MODES}
            context.buttons("Moves", modes, "Joints, or the tool along axes")
            self._buttons = gui.add_html("")
            context.buttons(  # below the joints: a phone shows half a page
                "Speed", {name: partial(self.jogging.set_speed, name) for name in SPEEDS}
            )
            self._pace = gui.add_html("")
            self._hand = gui.add_text("Held", "", visible=False)
        self._hand.on_update(self._hear)

    async def _hear(self, event: viser.GuiEvent[Any]) -> None:
        """On the server's own thread, for nothing may delay it."""
        held = read_held(event.target.value)
        if held is None:
            self.jogging.release()
        else:
            self.jogging.hold(held)

    def _wanted(self) -> Array | None:
        target = self._page.target
        return target.q if target.problem is None else None

    def _toggle(self) -> None:
        if self.jogging.mode is not None:
            self.jogging.close()
        elif self._may_start:
            self.jogging.start(self._mode)

    def _choose(self, mode: str) -> None:
        self._mode = mode
        if self.jogging.mode is not None:
            self.jogging.start(mode)

    def refresh(self) -> bool:
        jogging, state = self.jogging, self._arm.state
        if jogging.mode is not None and state.mode in (Mode.MOVING, Mode.HOLDING):
            self._context.bar.state = "Jogging"
        goes_on = any(self._next.look()) and jogging.outcome is self._outcome
        if jogging.mode is None and (goes_on or texts.blocked(state) is not None):
            jogging.outcome = None  # it is over, or what blocks the arm is said instead
        self._outcome = jogging.outcome
        before = self._shown
        self._shown = (
            jogging.mode, jogging.speed, self._mode, jogging.is_ready, jogging.held_by,
            jogging.outcome, self._may_start, self._words(),
        )  # fmt: skip
        return before != self._shown

    def show(self) -> None:
        jogging = self.jogging
        is_on = jogging.mode is not None
        self._sentence.content = self._context.sentence(self._words())
        self._switch.label = "End jogging" if is_on else "Start jogging"
        self._switch.disabled = not is_on and (self._is_far or not self._may_start)
        pace = SPEEDS[jogging.speed]
        figures = f"{to_deg(pace.turning):.0f} °/s"
        if self._mode in (BASE, TOOL):
            figures = f"{to_mm(pace.going):.0f} mm/s, turns {figures}"
        self._pace.content = markup.facts([(jogging.speed.capitalize(), figures)])
        self._buttons.content = jog_buttons(
            self._mode, jogging.speed, hand=uuid_of(self._hand) or "", is_on=jogging.is_ready
        )

    @property
    def _may_start(self) -> bool:
        state = self._arm.state
        return state.mode is Mode.HOLDING and texts.blocked(state) is None

    def _words(self) -> Sentence:
        jogging = self.jogging
        if self._is_far:
            return _FAR
        if jogging.mode is None:
            if jogging.outcome is None:
                return texts.blocked(self._arm.state) or _OFF
            ended = jogging.outcome
            return _STOPPED if isinstance(ended, Interrupted) else texts.ended(ended)
        if not jogging.is_ready:
            return _OPENS
        if jogging.held_by:
            held = texts.capital(", ".join(jogging.held_by))
            return Sentence(f"Held back: {held}", Tone.WARM)
        return _ARROWS if jogging.mode == ARROWS else _ON

    def left(self) -> None:
        self.jogging.close()

    close = left


_JOINT_ROWS = tuple(
    (i, joint, keys)
    for i, (joint, keys) in enumerate(zip(ARM_JOINTS, ("aq", "sw", "de", "fr", "gt"), strict=True))
)
_TOOL_ROWS = (
    (0, "X", "sw"),
    (1, "Y", "da"),
    (2, "Z", "fr"),
    (3, "turn about X", "ju"),
    (4, "turn about Y", "ki"),
    (5, "turn about Z", "lo"),
)
_JAW_ROW = (6, "gripper", "hy")


def jog_buttons(mode: str, speed: str, *, hand: str, is_on: bool) -> str:
    """Two buttons a row, less and more, with their keys.

    What is moved and how fast is lit above; ``hand`` is the id of the widget that hears of presses.
    """
    moved = _JOINT_ROWS if mode == JOINTS else () if mode == ARROWS else _TOOL_ROWS
    rows = "".join(_row(*row, is_on=is_on) for row in (*moved, _JAW_ROW))
    kind = "drag" if mode == ARROWS else "hold"
    on = "on" if is_on else "off"
    return (
        f'<div class="so101-jog" data-hand="{escape(hand)}" data-jog="{on}" data-kind="{kind}"'
        f' data-chosen="{escape(mode)} {escape(speed)}">{rows}</div>'
    )


def _row(axis: int, name: str, keys: str, *, is_on: bool) -> str:
    less, more = keys[0], keys[1]
    words = ("close", "open") if axis == _JAW_ROW[0] else ("less", "more")
    return (
        _button(axis, -1, "−", less, f"{name}, {words[0]}", is_on=is_on)
        + f"<span>{escape(name).replace('_', '_<wbr>')}</span>"  # a phone breaks it there
        + _button(axis, 1, "+", more, f"{name}, {words[1]}", is_on=is_on)
    )


def _button(axis: int, way: int, sign: str, key: str, name: str, *, is_on: bool) -> str:
    return (
        f'<button type="button" data-axis="{axis}" data-way="{way}" data-key="{key}"'
        f' aria-label="{escape(name)}"{"" if is_on else " disabled"}>'
        f"{sign} <kbd>{key.upper()}</kbd></button>"
    )
