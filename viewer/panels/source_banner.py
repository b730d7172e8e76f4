"""The banner at the top of the page: says when the arm is disconnected or not held.

An arm that is disconnected keeps its last picture, in grey. When it is back nothing moves: it holds
only after somebody presses Hold.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import datetime

import viser

from so101_motion.common.modes import Mode
from so101_motion.common.state import JointState
from so101_motion.rig.protocols import ArmConnection, RigLike
from so101_motion.rig.rig import Rig

from ..page import markup
from ..page.page_context import ArmContext
from ..page.part import Part
from ..page.screen_state import Sentence, Tone
from ..page.texts import capital


@dataclass(frozen=True, slots=True, kw_only=True)
class BannerContent:
    """The content of the banner.

    Attributes:
        title: Which arm, where nothing else says it.
        sentence: The sentence; None when all is well.
        can_hold: Whether pressing Hold is the way out.
    """

    title: str | None = None
    sentence: Sentence | None = None
    can_hold: bool = False


def waiting(title: str, error: Exception | None = None) -> BannerContent:
    """The banner before the first arm is found."""
    if error is None:
        return BannerContent(
            title=title, sentence=Sentence(text="Looking for the arm …", tone=Tone.WARM)
        )
    text = f"{capital(str(error))} Still looking."
    return BannerContent(title=title, sentence=Sentence(text=text, tone=Tone.BAD))


def notice(connection: ArmConnection, state: JointState, since: datetime) -> BannerContent:
    """The banner while there is an arm."""
    if connection.problem is not None:
        text = (
            f"Lost the {connection.to} at {since:%H:%M:%S}. {capital(connection.problem)} Showing"
            " its last position. It reconnects by itself; nothing will move."
        )
        return BannerContent(sentence=Sentence(text=text, tone=Tone.BAD))
    if state.mode is Mode.FAULT:
        text = f"Fault: {capital(state.fault or 'no reason given')} Fix this, then press Hold."
        return BannerContent(sentence=Sentence(text=text, tone=Tone.BAD), can_hold=True)
    if state.mode is Mode.LIMP:
        text = "The arm is limp. Press Hold to keep it where it is."
        return BannerContent(sentence=Sentence(text=text, tone=Tone.WARM), can_hold=True)
    if state.mode is Mode.GUIDING:
        text = "You can move the arm by hand. Press Hold to keep it where it is."
        return BannerContent(sentence=Sentence(text=text, tone=Tone.WARM), can_hold=True)
    return BannerContent()


class SourceBanner:
    """The banner's widgets: a line at the top right, and Hold under it."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._sentence = gui.add_html("", order=-10.0, visible=False)
        self.hold = gui.add_button(
            "Hold",
            order=-9.0,
            visible=False,
            icon=viser.Icon.HAND_STOP,
            hint="Holds the joints where they are; nothing moves",
        )

    def show(self, notice: BannerContent) -> None:
        """Show ``notice``."""
        head = "" if notice.title is None else markup.headline(notice.title, "")
        self._sentence.content = (
            "" if notice.sentence is None else head + markup.banner(notice.sentence)
        )
        self._sentence.visible = notice.sentence is not None
        self.hold.visible = notice.can_hold


class SourcePart(Part):
    """Watches the connection to an arm."""

    def __init__(
        self, context: ArmContext, line: SourceBanner, *, fade: Callable[[bool], None]
    ) -> None:
        self._context, self._rig, self._line, self._fade = context, context.rig, line, fade
        self._since = datetime.now()
        self._lost = False
        self._notice = BannerContent()
        context.on_press(line.hold, self._hold)

    def refresh(self) -> bool:
        """Check whether the arm is connected and ready."""
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
        """Update the banner."""
        self._line.show(self._notice)

    def _hold(self) -> None:
        self._context.beside(lambda: hold(self._rig)).add_done_callback(self._held)

    def _held(self, done: Future[None]) -> None:
        error = done.exception()
        if error is not None:
            self._context.events.add(f"Could not hold: {error}", Tone.BAD)


def hold(rig: RigLike) -> None:
    """Hold the joints where they stand; a grip is pressed again.

    Raises:
        So101Error: The cause of a fault is still there.
    """
    rig.arm.set_torque(True)
    if isinstance(rig, Rig):
        rig.gripper.regrip()
