"""What the bar says of the arm and its connection, and the ways home: hold, guide, let go.

An arm that is disconnected keeps its last picture, in grey. When it is back nothing moves: it holds
only after somebody presses Hold.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from datetime import datetime
from typing import Any

from so101_motion.common.modes import Mode
from so101_motion.common.state import JointState
from so101_motion.rig.protocols import ArmConnection, RigLike
from so101_motion.rig.rig import Rig

from ..page import texts
from ..page.bar import Bar, Way
from ..page.page_context import ArmContext
from ..page.part import Part
from ..page.screen_state import Sentence, Tone
from ..page.texts import capital

_HELD = (Mode.HOLDING, Mode.MOVING, Mode.STOPPING)
_SOURCE = "connection"


def waiting(bar: Bar, title: str, error: Exception | None = None) -> None:
    """Say in the bar that the first arm has not been found yet."""
    bar.state, bar.title = "No arm yet", title
    if error is None:
        said = Sentence(text="Looking for the arm …", tone=Tone.WARM)
    else:
        said = Sentence(text=f"{capital(str(error))} Still looking.", tone=Tone.BAD)
    bar.alert(_SOURCE, [said])


def notice(connection: ArmConnection, state: JointState, since: datetime) -> Sentence | None:
    """What to know of the connection and of the arm's mode; None when all is well."""
    if connection.problem is not None:
        text = (
            f"Lost the {connection.to} at {since:%H:%M:%S}. {capital(connection.problem)} Showing"
            " its last position. It reconnects by itself; nothing will move."
        )
        return Sentence(text=text, tone=Tone.BAD)
    if state.mode is Mode.FAULT:
        text = f"Fault: {capital(state.fault or 'no reason given')} Fix this, then press Hold."
        return Sentence(text=text, tone=Tone.BAD)
    if state.mode is Mode.LIMP:
        return Sentence(text="The arm is limp. Press Hold to keep it where it is.", tone=Tone.WARM)
    if state.mode is Mode.GUIDING:
        text = "You can move the arm by hand. Press Hold to keep it where it is."
        return Sentence(text=text, tone=Tone.WARM)
    return None


class WaysHome(Part):
    """Fills the bar for an arm.

    Args:
        title: Which arm it is.
        guide: Starts hand guiding for a limited time.
        fade: Told whether the drawn arm shall be grey.
    """

    def __init__(
        self,
        context: ArmContext,
        *,
        title: str,
        guide: Callable[[], None],
        fade: Callable[[bool], None],
    ) -> None:
        self._context, self._rig, self._fade = context, context.rig, fade
        self._since = datetime.now()
        self._lost = False
        bar = self._bar = context.bar
        bar.title = title
        self._hold = self._way("Hold", lambda: self._beside("hold", lambda: hold(self._rig)))
        self._guide = self._way("Guide by hand", guide)
        self._let_go = self._way("Let go", self._release)
        self._let_go.asks = "It will sink. Let go?"
        bar.ways = (self._hold, self._guide, self._let_go)

    def _way(self, label: str, command: Callable[[], None]) -> Way:
        button = self._context.gui.add_button(label, visible=False)
        self._context.on_press(button, command)
        return Way(label=label, button=button)

    def refresh(self) -> bool:
        """Check whether the arm is connected and ready, and fill the bar."""
        bar, connection, state = self._bar, self._rig.connection, self._rig.arm.state
        lost = connection.problem is not None
        if lost is not self._lost:
            self._lost, self._since = lost, datetime.now()
            self._fade(lost)
        bar.state = texts.mode(state, lost=lost)
        said = notice(connection, state, self._since)
        bar.alert(_SOURCE, () if said is None else (said,))
        mode = None if lost else state.mode
        self._hold.can = mode in (Mode.LIMP, Mode.GUIDING, Mode.FAULT)
        self._guide.can = mode in (Mode.HOLDING, Mode.LIMP)
        self._let_go.can = mode in (*_HELD, Mode.GUIDING, Mode.FAULT)
        return False

    def _release(self) -> None:
        self._beside("let go", lambda: self._rig.arm.set_torque(False))

    def _beside(self, what: str, call: Callable[[], None]) -> None:
        def ended(done: Future[Any]) -> None:
            error = done.exception()
            if error is not None:
                self._context.events.add(f"Could not {what}: {error}", Tone.BAD)

        self._context.beside(call).add_done_callback(ended)


def hold(rig: RigLike) -> None:
    """Hold the joints where they stand; a grip is pressed again.

    Raises:
        So101Error: The cause of a fault is still there.
    """
    rig.arm.set_torque(True)
    if isinstance(rig, Rig):
        rig.gripper.regrip()
