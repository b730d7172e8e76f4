"""The page that records the travel of every joint to both its stops.

Recording begins with the page, because it writes nothing. A bar for each joint turns green once
it has moved far enough. After a pulled cable the recording goes on when the arm is back.
"""

from __future__ import annotations

import viser

from so101_motion.calib.procedure import summary
from so101_motion.calib.procedure.steps import Command, State
from so101_motion.setup.setup_steps import RECORD

from ..page.shared_fields import SharedField
from . import calibration_cards, cards
from .page import CalibrationPage
from .setup_context import SetupContext

_TOO_EARLY = (
    "The homing pose is lost, because the calibration or this program ended after it. Press Back"
    " and take it again."
)


class RecordPage(CalibrationPage):
    """The page of the travels."""

    def __init__(self, setup: SetupContext) -> None:
        super().__init__(setup, RECORD)
        self._accepted: tuple[str, ...] = ()
        self._refused = ""  # why the recording could not end, said once
        self._missing: tuple[str, ...] = ()  # what was missing then

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        self._todo = gui.add_html("")
        self._bars = gui.add_html("")
        self._status = gui.add_html("")
        self._start = gui.add_button("Record", icon=viser.Icon.PLAYER_RECORD, visible=False)
        self._limited = gui.add_html("", visible=False)
        accept = gui.add_checkbox("Accept it", False, visible=False)
        self._finish = gui.add_button(
            "Finish the recording", icon=viser.Icon.CHECK, color="green", visible=False
        )
        on_press = self._setup.context.on_press
        on_press(self._start, self._record)
        on_press(self._finish, self._stop)
        self._accepts = SharedField(accept, self._take_as_is, self._setup.context, shown=bool)

    def enter(self) -> None:
        """Start recording."""
        self._accepted = ()
        target = self._setup.target
        if target is not None and target.calibrator.situation.view.state is State.HOMED:
            self._record()

    def leave(self) -> None:
        """Do nothing: the recording continues."""

    def show(self) -> None:
        """Show each joint's travel."""
        now, busy = self._now, bool(self._setup.doing)
        if now is None:
            return
        state, joints = now.view.state, now.joints
        seen = self._draw(now)
        is_on = state is State.RECORDING
        missing = summary.left(joints) if is_on else ()
        short = summary.short(joints) if is_on and not missing else ()
        self._setup.picture.light(missing)
        todo = _TOO_EARLY if self._lacks_pose() else _instruction(state, missing, short)
        self._todo.content = cards.instruction(RECORD.title, todo)
        has_bars = state in (State.RECORDING, State.COMPLETED)
        bars = calibration_cards.travels(summary.travels(joints)) if has_bars else ""
        self._show_accept(missing)
        is_about_picture = is_on and not self._limited.visible
        note = summary.picture_note(seen, joints) if is_about_picture else ""
        self._bars.content = bars + cards.note(note)
        self._status.content = self._about_trouble(now.view.error, missing)
        self._start.visible, self._finish.visible = state is State.HOMED, is_on
        self._start.disabled = busy
        self._finish.disabled = busy or bool(set(missing) - set(self._accepted))

    def _about_trouble(self, error: str | None, missing: tuple[str, ...]) -> str:
        """The present problem; a refused end of the recording expires when a joint moves."""
        trouble = self._setup.trouble
        if trouble is not None:
            self._refused, self._missing = str(trouble), self._missing or missing
            if missing != self._missing:
                self._setup.trouble, self._missing = None, ()
        return cards.failed(error) if error and error != self._refused else ""

    def _show_accept(self, missing: tuple[str, ...]) -> None:
        now = self._now
        offered = summary.acceptable(now.joints) if now is not None and missing else ()
        if offered != self._accepted:
            self._accepted = ()  # what was accepted is no longer what is offered
        self._limited.visible = bool(offered)
        self._limited.content = cards.note(
            f"Is something on the arm blocking {' and '.join(offered)}? Then accept it as it is."
        )
        self._accepts.show(bool(self._accepted) if offered else None)

    def can_go_on(self) -> str | None:
        """The joints that are not done."""
        if self._lacks_pose():
            return "press Back first: the homing pose is not taken"
        check = self.check()
        if check.verdict != "fail":
            return None
        if self._setup.known.view.error:
            return "resolve the problem above first"
        if check.sentence == "the recording goes on":
            return "finish the recording"
        return "move every joint to both its stops first"  # which ones is said above

    def _lacks_pose(self) -> bool:
        """Whether there is no homing pose, or none any more because this program restarted."""
        setup = self._setup
        return setup.saved is None and setup.known.view.state in (State.IDLE, State.STARTED)

    # What the widgets do

    def _record(self) -> None:
        self._do(
            "beginning to record", lambda target: target.calibrator.step(Command.START_RECORDING)
        )

    def _take_as_is(self, is_meant: bool) -> None:
        now = self._now
        offered = summary.acceptable(now.joints) if now is not None else ()
        self._accepted = offered if is_meant else ()

    def _stop(self) -> None:
        command, accepted = Command.STOP_RECORDING, self._accepted
        self._do("finishing", lambda target: target.calibrator.step(command, accept=accepted))


def _instruction(state: State, missing: tuple[str, ...], short: tuple[str, ...]) -> str:
    if state is State.COMPLETED:
        return "Everything is recorded. You may put the arm down."
    if state is not State.RECORDING:
        return RECORD.instruction
    if short:
        return (
            f"Not quite at both stops yet: {', '.join(short)}. Move them further; if they go no"
            " further, put the arm down, then finish."
        )
    if not missing:
        return "All joints have been at their stops. Put the arm down, then finish."
    return (
        "Move every joint slowly through its whole travel, to both stops, in any order. Each bar"
        f" turns green by itself. Still to do: {', '.join(missing)}."
    )
