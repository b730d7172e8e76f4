"""Says at the top of the page when the arm is not there, or not ready, and what to do.

An arm that cannot be reached keeps its last picture, in grey. When it is back nothing moves and
nothing is driven: it holds after somebody pressed Hold.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import datetime

import viser

from so101_motion.assembly import Rig
from so101_motion.modes import Mode
from so101_motion.rig_like import Connection, RigLike
from so101_motion.state import JointState

from . import markup
from .desk import Desk
from .screen import Sentence, Tone


@dataclass(frozen=True, slots=True, kw_only=True)
class Notice:
    """What there is to say of the source.

    Attributes:
        title: Which arm, where nothing else says it.
        said: The sentence; None when all is well.
        can_hold: Whether pressing Hold is the way out.
    """

    title: str | None = None
    said: Sentence | None = None
    can_hold: bool = False


def waiting(title: str, error: Exception | None = None) -> Notice:
    """Before there has been any arm."""
    if error is None:
        return Notice(title=title, said=Sentence(text="Looking for it …", tone=Tone.WARM))
    text = f"{_sentence(error)} The page goes on looking for it."
    return Notice(title=title, said=Sentence(text=text, tone=Tone.BAD))


def notice(connection: Connection, state: JointState, since: datetime) -> Notice:
    """With an arm.

    Args:
        connection: How it is reached.
        state: How it is, or was last.
        since: When it was lost, if it is.
    """
    if connection.problem is not None:
        text = (
            f"Lost the {connection.to} at {since:%H:%M:%S}. {_sentence(connection.problem)} It is"
            " shown as it was last. The page finds it again by itself; nothing moves then."
        )
        return Notice(said=Sentence(text=text, tone=Tone.BAD))
    if state.mode is Mode.FAULT:
        text = f"Fault: {_sentence(state.fault or 'no reason given')} See to it, then press Hold."
        return Notice(said=Sentence(text=text, tone=Tone.BAD), can_hold=True)
    if state.mode is Mode.LIMP:
        text = "The arm is limp. Hold keeps it where it is."
        return Notice(said=Sentence(text=text, tone=Tone.WARM), can_hold=True)
    if state.mode is Mode.GUIDING:
        text = "The arm yields to a hand. Hold ends that, where it is."
        return Notice(said=Sentence(text=text, tone=Tone.WARM), can_hold=True)
    return Notice()


class SourceLine:
    """The widgets: one line above everything else on the right, and Hold under it.

    Args:
        gui: Where to make them.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        self._said = gui.add_html("", order=-10.0, visible=False)
        self.hold = gui.add_button(
            "Hold",
            order=-9.0,
            visible=False,
            icon=viser.Icon.HAND_STOP,
            hint="Drives the joints where they stand now; nothing moves",
        )

    def show(self, notice: Notice) -> None:
        """Tell ``notice``."""
        head = "" if notice.title is None else markup.headline(notice.title, "")
        self._said.content = "" if notice.said is None else head + markup.banner(notice.said)
        self._said.visible = notice.said is not None
        self.hold.visible = notice.can_hold


class SourcePart:
    """Watches the source of an arm that was found.

    Args:
        desk: Where it works.
        line: Where to say it.
        fade: Shows the arm in grey, or as ever.
    """

    def __init__(self, desk: Desk, line: SourceLine, *, fade: Callable[[bool], None]) -> None:
        self._desk, self._rig, self._line, self._fade = desk, desk.rig, line, fade
        self._since = datetime.now()
        self._lost = False
        self._notice = Notice()
        desk.on_press(line.hold, self._hold)

    def refresh(self) -> bool:
        """Look whether the arm is there and ready."""
        connection = self._rig.connection
        lost = connection.problem is not None
        if lost and not self._lost:
            self._since = datetime.now()
        before, self._notice = self._notice, notice(connection, self._rig.arm.state, self._since)
        if lost is not self._lost:
            self._lost = lost
            self._fade(lost)
        return before != self._notice

    def show(self) -> None:
        """Say it."""
        self._line.show(self._notice)

    def close(self) -> None:
        """Nothing is held."""

    def _hold(self) -> None:
        self._desk.beside(lambda: hold(self._rig)).add_done_callback(self._held)

    def _held(self, done: Future[None]) -> None:
        error = done.exception()
        if error is not None:
            self._desk.events.tell(f"Could not hold: {error}", Tone.BAD)


def hold(rig: RigLike) -> None:
    """Drive the joints where they stand; what was gripped is gripped again.

    Raises:
        So101Error: The cause of a fault is still there.
    """
    rig.arm.set_torque(True)
    if isinstance(rig, Rig):
        rig.gripper.regrip()


def _sentence(reason: str | Exception) -> str:
    text = str(reason).rstrip(".")
    return f"{text[:1].upper()}{text[1:]}."
