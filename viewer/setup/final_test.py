"""The page of the final test: small slow motions, agreed to beforehand and measured.

It says what will move and how far, and moves nothing until a person has agreed. The test runs in
its own thread, so Stop, Back and Abort work all the time; each ends it with the arm held. At the
end a person is asked whether the arm moved as its picture did, which no encoder can tell.
"""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import viser

from so101_motion import __version__
from so101_motion.common.modes import HELD, Mode
from so101_motion.common.state import JointState
from so101_motion.setup.accuracy import MoveReport
from so101_motion.setup.calibration_operation import OPEN_POSE
from so101_motion.setup.checkup import Check
from so101_motion.setup.move_test import MoveTest, MoveTestProgress, Outline
from so101_motion.setup.setup_steps import TEST

from ..page import cards
from ..page.shared_fields import SharedField, put
from . import calibration_cards
from .page import StepPage
from .setup_context import SetupContext
from .setup_target import SetupTarget

_BY_HAND = (
    "Move it by hand to a pose like the blue ghost's, clear of everything, then press Hold the"
    " joints."
)
_FIXED = "Once that is fixed, press Hold the joints. Keep a hand on the arm."
_CLEAR = (
    "Tick the box when nothing is in its way and no hand is near it. To change its pose first,"
    " press Guide by hand at the top."
)
_SEEN = "Did the arm move as in the picture: the same joints, in the same directions?"
_AS_SHOWN, _NOT_AS_SHOWN = "Yes", "No, it differs"


class FinalTest:
    """One test, from its outline to its report, on its own thread."""

    def __init__(self, target: SetupTarget) -> None:
        assert target.rig is not None  # there is no test without one
        rig = target.rig
        self._test = MoveTest(
            arm=rig.arm, gripper=rig.gripper, clock=rig.clock, name=f"arm on {target.where}"
        )
        self._thread: threading.Thread | None = None
        self.outline: Outline | None = None
        self.progress: MoveTestProgress | None = None
        self.report: MoveReport | None = None
        self.trouble: BaseException | None = None

    def plan(self) -> FinalTest:
        """Plan the test motions; takes a moment."""
        self.outline = self._test.outline()
        return self

    @property
    def is_running(self) -> bool:
        """Whether the arm is moving."""
        return self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """Start the motions."""
        self._thread = threading.Thread(target=self._run, name="so101-setup-test", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Stop a running test; returns when the arm is at rest."""
        self._test.cancel()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        assert self.outline is not None  # it is what was agreed to
        try:
            self.report = self._test.move_and_measure(self.outline, self._tell)
        except BaseException as error:  # shown on the page
            self.trouble = error

    def _tell(self, progress: MoveTestProgress) -> None:
        self.progress = progress


class FinalTestPage(StepPage):
    """The page of the final test."""

    def __init__(self, setup: SetupContext) -> None:
        super().__init__(setup, TEST)
        self._test: FinalTest | None = None
        self._is_agreed = False
        self._was_ended = False  # whether the last test was stopped
        self._is_planned = False  # whether there is a plan, or need be none, since the arm is held
        self._shown: tuple[object, ...] = ()

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        self._todo = gui.add_html("")
        self._hold = gui.add_button("Hold the joints", icon=viser.Icon.LOCK, visible=False)
        agree = gui.add_checkbox("Everything is out of the way", False, visible=False)
        self._start = gui.add_button(
            "Move and measure", icon=viser.Icon.PLAYER_PLAY, color="green", visible=False
        )
        self._stop = gui.add_button(
            "Stop the test", icon=viser.Icon.HAND_STOP, color="red", visible=False
        )
        self._bar = gui.add_progress_bar(0.0, color="green", visible=False)
        self._result = gui.add_html("")
        self._asked = gui.add_html("", visible=False)
        self._seen = gui.add_button_group("", (_AS_SHOWN, _NOT_AS_SHOWN), visible=False)
        self._table = gui.add_html("")
        self._again = gui.add_button(
            "Test again", icon=viser.Icon.REPEAT, color="gray", visible=False
        )
        self._keep = gui.add_button(
            "Save the report", icon=viser.Icon.DOWNLOAD, color="gray", visible=False
        )
        context = self._setup.context
        context.on_press(self._hold, self._hold_joints)
        context.on_press(self._start, self._move)
        context.on_press(self._stop, self._end)
        context.on_press(self._again, self._test_again)
        context.on_choice(self._seen, self._answer)
        context.on_asked(self._keep, self._hand_over)
        self._agreed = SharedField(agree, self._agree_to, context, shown=bool)

    def enter(self) -> None:
        """Show the last test, or plan another one."""
        self._is_agreed = False
        if self._setup.tested is None:  # the arm has changed since the last test, if any
            self._test = None
        self._is_planned = self._test is not None

    def leave(self) -> None:
        """End a running test; the arm holds."""
        if self._test is not None:
            self._test.end()

    def refresh(self) -> bool:
        """Take in the state of arm and test; plan the motions once the arm is held."""
        state = self._state()
        if state is not None and state.mode in HELD:
            self._is_planned = self._is_planned or self._plan()
        else:
            self._forget_plan()
        test = self._test
        found = None if test is None else (test.is_running, test.progress, test.report)
        seen = None if state is None else (state.mode, *np.round(state.q, 4), round(state.q_jaw, 3))
        before, self._shown = self._shown, (seen, test, found, self._is_agreed)
        self._conclude()
        return self._shown != before

    def show(self) -> None:
        """Show the planned motions, the running one, and the results."""
        state, test, busy = self._state(), self._test, bool(self._setup.doing)
        holds = state is not None and state.mode in HELD
        runs = test is not None and test.is_running
        report = None if test is None else test.report
        outline = None if test is None else test.outline
        if state is not None:
            self._setup.picture.move(state.q, state.q_jaw)
        self._todo.content = self._words(holds=holds)
        self._hold.visible = state is not None and not holds
        self._hold.disabled = busy
        can_begin = holds and not runs and outline is not None and report is None
        is_loose = state is not None and state.mode in (Mode.LIMP, Mode.GUIDING)
        self._setup.picture.ghost(OPEN_POSE if is_loose else None, state.q_jaw if state else 0.0)
        self._start.visible = can_begin
        self._agreed.show(self._is_agreed if can_begin else None)
        self._start.disabled = not self._is_agreed or busy
        self._stop.visible = self._bar.visible = runs
        progress = None if test is None else test.progress
        put(self._bar, 0.0 if progress is None else round(100.0 * progress.share, 1))
        self._show_results(report, progress if runs else None)

    def _show_results(self, report: MoveReport | None, progress: MoveTestProgress | None) -> None:
        lit = () if progress is None or not progress.joint else (progress.joint,)
        self._setup.picture.light(lit)
        joints = () if report is None else report.joints
        self._table.content = calibration_cards.report(
            joints if progress is None else progress.results
        )
        is_over = progress is None and report is not None
        self._result.content = calibration_cards.result(report) if report and is_over else ""
        asks = is_over and self._is_asked
        self._asked.visible = self._seen.visible = asks
        self._asked.content = cards.instruction("", _SEEN) if asks else ""
        self._again.visible = self._keep.visible = is_over
        self._again.color = None if report is not None and not report.passed else "gray"
        state = self._state()
        holds = state is not None and state.mode in HELD
        self._again.disabled = bool(self._setup.doing) or not holds

    def _words(self, *, holds: bool) -> str:
        target, test = self._setup.target, self._test
        if target is None or target.rig is None:
            return cards.instruction(
                TEST.title, "This arm cannot be moved from here. You may go on."
            )
        if not holds:
            return self._about_hold()
        if test is None or test.outline is None:
            return cards.instruction(TEST.title, TEST.instruction)
        if test.is_running:
            joint = "" if test.progress is None else test.progress.joint
            doing = f"moving {joint}; Space or Stop ends it" if joint else "it begins"
            return cards.instruction(TEST.title, "") + cards.going_on(doing)
        if test.report is not None:
            return cards.instruction(TEST.title, "")
        html = cards.instruction("This will move:", test.outline.sentence)
        html += cards.note(test.outline.left_out)
        if test.trouble is not None:
            html += cards.failed(str(test.trouble))
        return html + cards.note(_CLEAR)

    def _about_hold(self) -> str:
        """Why the arm does not hold, and what to do."""
        state = self._state()
        if state is None or state.mode is not Mode.FAULT:
            is_guided = state is not None and state.mode is Mode.GUIDING
            yields = "The arm yields to your hand." if is_guided else "The arm is not held."
            return cards.instruction(TEST.title, f"{yields} {_BY_HAND}")
        trouble = cards.failed(state.fault or "the arm has ended its motion by itself")
        return cards.instruction(TEST.title, "") + trouble + cards.note(_FIXED)

    @property
    def _can_test(self) -> bool:
        """Whether this arm can be moved from here."""
        return self._setup.target is not None and self._setup.target.rig is not None

    @property
    def _is_asked(self) -> bool:
        """Whether it is still to be said how the arm moved."""
        report = None if self._test is None else self._test.report
        return report is not None and report.as_shown is None and not report.ended_by

    def next_label(self) -> str:
        """Next says what it does after a test that is missing or that has failed."""
        tested = self._setup.tested
        if not self._can_test:
            return "Next"
        if tested is None or self._was_ended:
            return "Skip the test"
        return "Go on anyway" if tested.verdict == "fail" else "Next"

    def is_next_due(self) -> bool:
        """Whether the test is passed and its question answered, or there can be none."""
        tested = self._setup.tested
        if not self._can_test:
            return True
        return tested is not None and tested.verdict != "fail" and not self._is_asked

    def can_go_on(self) -> str | None:
        """A running test keeps from going on; a skipped or failed one does not."""
        is_running = self._test is not None and self._test.is_running
        return "the test is running" if is_running else None

    def abort(self) -> str:
        """End the test; the arm holds where it is."""
        if self._test is not None:
            self._test.end()
        return super().abort()

    def _as_it_was(self) -> str:
        state = self._state()
        holds = state is not None and state.mode in HELD
        where = "the arm is held where it stands" if holds else "the arm is limp, so support it"
        return f"what was saved stays, and {where}"

    # What the widgets do

    def _plan(self) -> bool:
        """Plan the motions from where the arm is; return whether that has begun."""
        target, state = self._setup.target, self._state()
        if target is None or state is None or state.mode not in HELD:
            return False
        test = FinalTest(target)
        return self._setup.do("planning the test", test.plan, self._take)

    def _forget_plan(self) -> None:
        """Forget a plan that was not carried out to its end: a hand may move the arm now."""
        test, state = self._test, self._state()
        if test is not None and (test.is_running or (test.report and not test.report.ended_by)):
            return
        self._is_agreed = self._is_planned = False
        is_told = test is not None and test.report is not None  # what ended it is shown with it
        if not is_told or (state is not None and state.mode is not Mode.FAULT):
            self._test = None

    def _test_again(self) -> None:
        self._plan()

    def _take(self, test: FinalTest) -> None:
        self._test = test

    def _hold_joints(self) -> None:
        self._do("holding the joints", lambda target: target.hold())

    def _agree_to(self, is_clear: bool) -> None:
        self._is_agreed = is_clear

    def _move(self) -> None:
        test = self._test
        if test is None or test.report is not None or test.is_running or self._setup.doing:
            return
        if self._is_agreed:
            self._is_agreed, self._setup.tested = False, None
            test.start()

    def _end(self) -> None:
        if self._test is not None:
            self._test.end()

    def _answer(self, name: str) -> None:
        test = self._test
        if test is not None and test.report is not None:
            test.report = replace(test.report, as_shown=name == _AS_SHOWN)
            self._setup.tested = None

    def _hand_over(self, client: viser.ClientHandle) -> None:
        test = self._test
        if test is None or test.report is None:
            return
        name = f"so101-move-test-{test.report.began_at[:19].replace(':', '')}.json"
        client.send_file_download(
            name, test.report.file({"version": __version__}), save_immediately=True
        )

    # Helpers

    def _state(self) -> JointState | None:
        target = self._setup.target
        return None if target is None or target.rig is None else target.rig.arm.state

    def _conclude(self) -> None:
        """Pass the result to the other pages."""
        report = None if self._test is None else self._test.report
        if report is not None and self._setup.tested is None:
            warned = any(joint.verdict == "warn" for joint in report.joints)
            self._was_ended = bool(report.ended_by)
            self._setup.tested = Check(
                name="test",
                verdict="fail" if not report.passed else "warn" if warned else "ok",
                sentence=report.sentence,
                fix=_what_to_do(report),
            )


def _what_to_do(report: MoveReport) -> str:
    """What to do after a test; empty when it is passed."""
    if report.passed:
        return ""
    if report.ended_by:
        return "press Back and test again"
    return "press Back, read the note at each joint, then test again"
