"""The page on which every joint is moved to both its stops.

Recording begins with the page, for it writes nothing. A bar for each joint shows how far it has
been and turns green by itself. A cable that is pulled costs nothing: it is said, and the recording
goes on when the arm is back.
"""

from __future__ import annotations

import viser

from so101_motion.calib.steps import State
from so101_motion.workflow import RECORD

from ..fields import Field
from . import calibrating, calibration_cards, cards
from .page import CalibrationPage
from .workshop import Workshop

_TOO_EARLY = (
    "There is no homing pose to count from: this program was ended after it was taken, or the"
    " calibration was. Press Back, and take it again."
)


class RecordPage(CalibrationPage):
    """The page of the travels.

    Args:
        shop: What all pages share.
    """

    def __init__(self, shop: Workshop) -> None:
        super().__init__(shop, RECORD)
        self._accepted: tuple[str, ...] = ()
        self._refused = ""  # why the recording could not end, said once
        self._missing: tuple[str, ...] = ()  # what was missing then

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        self._todo = gui.add_html("")
        self._bars = gui.add_html("")
        self._said = gui.add_html("")
        self._start = gui.add_button("Record", icon=viser.Icon.PLAYER_RECORD, visible=False)
        self._limited = gui.add_html("", visible=False)
        self._accept = gui.add_checkbox("Accept it", False, visible=False)
        self._finish = gui.add_button(
            "Finish the recording", icon=viser.Icon.CHECK, color="green", visible=False
        )
        on_press = self._shop.desk.on_press
        on_press(self._start, self._record)
        on_press(self._finish, self._stop)
        self._accepts = Field(self._accept, self._take_as_is, self._shop.desk, shown=bool)

    def enter(self) -> None:
        """Begin to record."""
        self._accepted = ()
        bench = self._shop.bench
        if bench is not None and bench.calibrator.situation.view.state is State.HOMED:
            self._record()

    def leave(self) -> None:
        """What is recorded stays, and the recording goes on."""

    def show(self) -> None:
        """Tell how far each joint is."""
        now, busy = self._watch.now, bool(self._shop.doing)
        if now is None:
            return
        state, joints = now.view.state, now.joints
        seen = self._watch.draw()
        assert seen is not None  # there is a situation
        is_on = state is State.RECORDING
        missing = calibrating.left(joints) if is_on else ()
        short = calibrating.short(joints) if is_on and not missing else ()
        self._shop.picture.light(missing)
        todo = _TOO_EARLY if self._lacks_pose() else _instruction(state, missing, short)
        self._todo.content = cards.instruction(RECORD.title, todo)
        has_bars = state in (State.RECORDING, State.COMPLETED)
        bars = calibration_cards.travels(calibrating.travels(joints)) if has_bars else ""
        note = calibrating.picture_note(seen, joints) if is_on else ""
        self._bars.content = bars + cards.note(note)
        self._said.content = self._about_trouble(now.view.error, missing)
        self._start.visible, self._finish.visible = state is State.HOMED, is_on
        self._start.disabled = busy
        self._show_accept(missing if is_on else ())
        self._finish.disabled = busy or bool(set(missing) - set(self._accepted))

    def _about_trouble(self, error: str | None, missing: tuple[str, ...]) -> str:
        """What is wrong now. Why a recording could not end is old when a joint has moved on."""
        trouble = self._shop.trouble
        if trouble is not None:
            self._refused, self._missing = str(trouble), self._missing or missing
            if missing != self._missing:
                self._shop.trouble, self._missing = None, ()
        return cards.failed(error) if error and error != self._refused else ""

    def _show_accept(self, missing: tuple[str, ...]) -> None:
        now = self._watch.now
        offered = calibrating.acceptable(now.joints) if now is not None and missing else ()
        if offered != self._accepted:
            self._accepted = ()  # what was agreed to is not what is asked now
        self._limited.visible = self._accept.visible = bool(offered)
        self._limited.content = cards.note(
            f"Does something on your arm keep {' and '.join(offered)} from going farther? Then"
            " accept what was recorded as it is."
        )
        self._accepts.show(bool(self._accepted))

    def can_go_on(self) -> str | None:
        """Which are not."""
        if self._lacks_pose():
            return "go back first: the homing pose is not taken"
        check = self.check()
        if check.verdict != "fail":
            return None
        if self._shop.known.view.error:
            return "first see to what is said above"
        return (
            "finish the recording" if check.sentence == "the recording goes on" else check.sentence
        )

    def _lacks_pose(self) -> bool:
        """Whether there is nothing to record yet, or not any more: this program was ended."""
        shop = self._shop
        return shop.saved is None and shop.known.view.state in (State.IDLE, State.STARTED)

    # What the widgets do

    def _record(self) -> None:
        self._do("beginning to record", lambda bench: bench.calibrator.start_recording())

    def _take_as_is(self, is_meant: bool) -> None:
        now = self._watch.now
        offered = calibrating.acceptable(now.joints) if now is not None else ()
        self._accepted = offered if is_meant else ()

    def _stop(self) -> None:
        accepted = self._accepted
        self._do("finishing", lambda bench: bench.calibrator.stop_recording(accept=accepted))


def _instruction(state: State, missing: tuple[str, ...], short: tuple[str, ...]) -> str:
    if state is State.COMPLETED:
        return "Everything is recorded. You may put the arm down."
    if state is not State.RECORDING:
        return RECORD.instruction
    if short:
        return (
            f"Not quite at both stops yet: {', '.join(short)}. Move on to them, or, if that is as"
            " far as it goes, put the arm down, then finish."
        )
    if not missing:
        return "All joints have been at their stops. Put the arm down, then finish."
    return (
        "Move every joint slowly through its whole travel, to both stops, in any order. Each bar"
        f" turns green by itself. Still to do: {', '.join(missing)}."
    )
