"""The buttons Hold, Guide by hand and Let go, and what the bar says about the arms.

When a lost arm is back nothing moves until somebody presses Hold. If its servos hold another
calibration than the file, Hold is refused, and a fourth button stores the file in them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from datetime import datetime
from functools import partial
from typing import Any

from so101_motion.common.errors import OtherCalibration
from so101_motion.common.modes import HELD, Mode
from so101_motion.common.state import ANSWERS_AGAIN, JointState
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.protocols import ArmConnection, RigLike
from so101_motion.rig.rig import Rig

from ..page import texts
from ..page.bar import CONNECTION, Bar, BarButton
from ..page.causes import NextEvent
from ..page.page_context import PageContext, Part
from ..page.screen_state import Sentence, Tone
from ..page.texts import capital


def waiting(bar: Bar, title: str, error: Exception | None = None) -> None:
    bar.state, bar.title = "No arm yet", title
    if error is None:
        said = Sentence("Looking for the arm …", Tone.WARM)
    else:
        said = Sentence(f"{capital(str(error))} Still looking.", Tone.BAD)
    bar.alert(CONNECTION, [said])


def notice(
    connection: ArmConnection, state: JointState, since: datetime, *, is_back: bool = False
) -> Sentence | None:
    """What is wrong with a connection, lost ``since`` then, or with the arm's mode, or None.

    It ``is_back`` when the fault is that it was lost, and it is there again.
    """
    if connection.problem is not None:
        port = connection.to.removeprefix("arm on ")
        why = connection.problem.removeprefix(f"{port}: ")  # it is named already
        why = capital(why.removesuffix(" and the name"))  # which was right until now
        text = (
            f"Lost the {connection.to} at {since:%H:%M:%S}. {why} While it has power, an arm that"
            " held goes on holding. It reconnects by itself; nothing moves."
        )
        return Sentence(text, Tone.BAD)
    if state.mode is Mode.FAULT and is_back:
        return Sentence("Connected again. Nothing moves. Press Hold to go on.", Tone.WARM)
    if state.mode is Mode.FAULT:
        first = "Nothing moves. Press" if state.fault == ANSWERS_AGAIN else "Fix this, then press"
        why = (state.fault or "no reason given").rstrip(".")
        return Sentence(f"Fault: {why}. {first} Hold.", Tone.BAD)
    if state.mode is Mode.LIMP:
        text = "The arm is limp. Press Hold to keep it where it is."
        if state.torque:
            text = f"The arm {state.torque}. Press Hold to use it as it stands, or Let go."
        return Sentence(text, Tone.WARM)
    if state.mode is Mode.GUIDING and connection.is_simulated:
        text = "A real arm could be moved by hand now; a simulated one cannot. Press Hold to go on."
        return Sentence(text, Tone.WARM)
    if state.mode is Mode.GUIDING:
        text = "You can move the arm by hand. Press Hold to keep it where it is."
        return Sentence(text, Tone.WARM)
    return None


class HoldButtons(Part):
    """Fills the bar for the arms of a page; each button is for all of them.

    Args:
        guide: Starts hand guiding for a limited time, of arms whose servos are driven.
        fade: Shows an arm in grey, or in its own colours.
    """

    def __init__(
        self,
        context: PageContext,
        *,
        title: str,
        rigs: Mapping[str, RigLike],
        guide: Callable[[], None],
        fade: Mapping[str, Callable[[bool], None]],
    ) -> None:
        self._context, self._rigs, self._fade = context, dict(rigs), fade
        self._lost_at: dict[str, datetime] = {}
        self._old_faults: dict[str, str | None] = {}  # of arms that are back after they were lost
        self._refused: dict[str, OtherCalibration] = {}  # of arms whose servos hold another
        self._next = {name: NextEvent(rig.arm) for name, rig in rigs.items()}
        self._stopped: set[str] = set()  # of arms that were stopped and have not moved since
        bar = self._bar = context.bar
        bar.title = title
        self._hold = self._button("Hold", lambda: self._each("hold", hold))
        self._start_guiding = guide
        self._guide = self._button("Guide by hand", lambda: self._each("guide by hand", _drive))
        self._let_go = self._button("Let go", lambda: self._each("let go", _release))
        self._let_go.asks = texts.SINKS if len(rigs) == 1 else "All will sink. Let go?"
        self._accept = self._button("Store the file", lambda: self._each("store the file", _accept))
        self._accept.why_not, self._accept.asks = None, "It may sink. Store it in the servos?"
        self._buttons = bar.buttons = (self._hold, self._guide, self._let_go)

    def _button(self, label: str, command: Callable[[], None]) -> BarButton:
        return BarButton(label=label, button=self._context.button(label, command, visible=False))

    def refresh(self) -> bool:
        modes: list[Mode] = []  # of the arms that are connected
        can_let_go = False
        states: dict[str, str] = {}
        alerts: dict[Sentence, list[str]] = {}  # of which arms each is true
        back: list[str] = []
        for name, rig in self._rigs.items():
            connection, state = rig.connection, rig.arm.state
            lost = connection.problem is not None or is_unplugged(rig)
            if lost is not (name in self._lost_at):
                self._fade[name](lost)
                if lost:
                    self._lost_at[name] = datetime.now()
                else:
                    del self._lost_at[name]
                    self._old_faults[name] = state.fault
            if state.mode is not Mode.FAULT:
                self._old_faults.pop(name, None)
            if state.mode in HELD:
                self._refused.pop(name, None)
            stopped, began = self._next[name].look()
            if stopped:
                self._stopped.add(name)
            elif began or state.mode not in HELD:
                self._stopped.discard(name)
            if not lost:
                modes.append(state.mode)
                can_let_go |= state.mode is Mode.LIMP and not state.is_limp
            is_back = name in self._old_faults and self._old_faults[name] == state.fault
            back += [name] if is_back and not lost else []
            is_stopped = name in self._stopped
            words = texts.mode(state, lost=lost, is_stopped=is_stopped)
            states[name] = "Connected again" if name in back else words
            lost_at = self._lost_at.get(name, datetime.now())
            said = notice(connection, state, lost_at, is_back=is_back)
            if said is not None:
                alerts.setdefault(said, []).append(self._called(name))
        one = len(set(states.values())) == 1
        self._bar.state = (
            next(iter(states.values()))
            if one
            else "; ".join(f"{name}: {words}" for name, words in states.items())
        )
        for name, refused in self._refused.items():
            text = f"{capital(str(refused))}; or press Store the file."
            alerts.setdefault(Sentence(text, Tone.BAD), []).append(self._called(name))
        self._bar.buttons = (*self._buttons, *([self._accept] if self._refused else []))
        said_of = (texts.named(", ".join(names), said) for said, names in alerts.items())
        self._bar.alert(CONNECTION, list(said_of))
        self._tell_tabs(back)
        self._hold.why_not = _why_not(modes, texts.CANNOT_HOLD)
        self._guide.why_not = _why_not(modes, texts.CANNOT_GUIDE)
        self._let_go.why_not = None if can_let_go else _why_not(modes, texts.CANNOT_LET_GO)
        return False

    def _tell_tabs(self, back: list[str]) -> None:
        said = texts.DISCONNECTED if self._lost_at else texts.BACK if back else None
        if said is not None:
            said = texts.named(", ".join(map(self._called, self._lost_at or back)), said)
        if said != self._bar.lost:
            self._bar.lost = said
            self._context.post(lambda: None)  # after a command every tab is shown anew

    def _called(self, name: str) -> str:
        return name if len(self._rigs) > 1 else ""

    def _each(self, what: str, call: Callable[[RigLike], None]) -> None:
        def ended(name: str, done: Future[Any]) -> None:
            error = done.exception()
            if isinstance(error, OtherCalibration):
                self._refused[name] = error
            elif error is None and call is not _release:
                self._refused.pop(name, None)
            if error is None and call is _drive:
                self._context.post(self._start_guiding)
            if error is not None:
                doing = f"{what} {self._called(name)}".strip()
                self._context.events.add(f"Could not {doing}: {error}", Tone.BAD)

        for name, rig in self._rigs.items():
            if call is not _accept or name in self._refused:
                done = self._context.in_background(partial(call, rig))
                done.add_done_callback(partial(ended, name))


def is_unplugged(rig: RigLike) -> bool:
    """Whether a machine, which answers, says that its arm is away."""
    return getattr(rig, "status", {}).get("connected") is False


def _why_not(modes: list[Mode], cannot: Mapping[Mode, str]) -> str | None:
    if not modes:
        return "No arm is connected."
    return cannot.get(modes[0]) if all(mode in cannot for mode in modes) else None


def _drive(rig: RigLike) -> None:
    """Drive the servos of an arm that was only looked at; it holds where it is."""
    if isinstance(rig, HardwareRig):
        rig.drive()


def _release(rig: RigLike) -> None:
    rig.arm.set_torque(False)


def _accept(rig: RigLike) -> None:
    if isinstance(rig, HardwareRig):
        rig.write_calibration()


def hold(rig: RigLike) -> None:
    """Hold the joints where they stand and press a grip again; raises if a fault remains."""
    _drive(rig)
    rig.arm.set_torque(True)
    if isinstance(rig, Rig):
        rig.gripper.regrip()
