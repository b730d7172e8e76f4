"""The pages of the setup's steps, most the panel of the step's operation.

A page never waits: calls to motors run on a worker thread, and ``refresh`` takes in the result. It
keeps nothing in the browser, so a reload loses nothing. All but ``abort`` run on the page's thread.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from html import escape
from pathlib import Path

import viser

from so101_motion import __version__
from so101_motion.calib.procedure.steps import State
from so101_motion.common.modes import HELD
from so101_motion.common.operation import Operation, View
from so101_motion.drivers.bus.defaults import SERVO_IDS
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.port_settings import ServoSettings
from so101_motion.setup import connect
from so101_motion.setup.checkup import Check
from so101_motion.setup.connect import ConnectOperation
from so101_motion.setup.discovery import configuration
from so101_motion.setup.move_test import MARKS, MoveTest
from so101_motion.setup.setup_steps import (
    CHAIN,
    CONFIGURE,
    CONNECT,
    POSE,
    RECORD,
    TEST,
    SetupStep,
)

from ..page import cards, markup
from ..page.operation_panel import OperationPanel
from .setup_context import ArmSource, ServesPreview, SetupContext, SetupTarget


class StepPage:
    """The page of one step.

    Args:
        setup: What all pages share.
        operation: Which of the target's operations does the step.
        left: How an abort leaves the arm when no calibration is under way, in words.
        skip: What Next is called until all is well.
    """

    def __init__(
        self,
        setup: SetupContext,
        step: SetupStep,
        operation: Callable[[SetupTarget], Operation | None] = lambda _target: None,
        left: str = "nothing was changed, and nothing was moved",
        skip: str = "Next",
    ) -> None:
        self._setup, self._step, self._of, self._left = setup, step, operation, left
        self._skip = skip
        self._checked: Check | None = None
        self._panel = OperationPanel(
            setup.context,
            lambda: self.operation,
            worker=setup,
            draw=self._draw,
            as_shown=self._as_shown,
            by_enter=step.name == "motors",
        )

    @property
    def operation(self) -> Operation | None:
        target = self._setup.target
        return None if target is None else self._of(target)

    def build(self, gui: viser.GuiApi) -> None:
        self._panel.build(gui)

    def enter(self) -> None:
        """Start the step, also when it is entered again."""

    def leave(self) -> None:
        """Leave the step; nothing of it may continue."""

    def refresh(self) -> bool:
        before, self._checked = self._checked, self.check()  # what keeps it from being left
        return self._panel.refresh() or self._checked != before

    def show(self) -> None:
        self._panel.show()

    def check(self) -> Check:
        return self._step.check(self._setup.known)

    def can_go_on(self) -> str | None:
        """Why Next is not allowed yet, as a sentence; None if it is."""
        check = self.check()
        return check.sentence if check.verdict == "fail" else None

    def next_label(self) -> str:
        return "Next" if self.check().verdict == "ok" else self._skip

    def is_next_due(self) -> bool:
        """Whether Next is what to press now; else it is grey, though it may be pressed."""
        operation = self.operation
        return operation is None or self._as_shown(operation.view).is_over

    def abort(self) -> str:
        """Abort what was started, a calibration as well; return the result in words."""
        target = self._setup.target
        if target is None or not target.is_under_way:
            return self._as_it_was()
        return str(target.calibration.ask("abort")["message"]).rstrip(".")

    def _as_it_was(self) -> str:
        return self._left

    def _ask(self, command: str, doing: str) -> None:
        if self.operation is not None:
            self._setup.do(doing, partial(self.operation.ask, command))

    def _as_shown(self, view: View) -> View:
        """Over once Next is due, so that only one button shines."""
        verdict = self.check().verdict
        return replace(view, is_over=verdict == "ok" or (view.is_over and verdict != "fail"))

    def _draw(self, view: View) -> None:
        if view.picture is not None:
            self._setup.picture.draw(view.picture)


_DONE = {
    POSE.name: ("The pose is taken", (State.HOMED, State.RECORDING, State.COMPLETED)),
    RECORD.name: ("The travel is recorded", (State.COMPLETED,)),
}
"""What is said of a step of the calibration that is done, and in which states it is."""


class CalibrationPage(StepPage):
    """The page of one step of the calibration."""

    def __init__(self, setup: SetupContext, step: SetupStep) -> None:
        super().__init__(setup, step, lambda target: target.calibration, "nothing was changed")
        self._before = ""

    def enter(self) -> None:
        target, self._before = self._setup.target, ""
        if target is not None and self._step.name == "save" and self._setup.saved is None:
            self._setup.saved = target.situation.saved

    def refresh(self) -> bool:
        news, target = super().refresh(), self._setup.target
        if target is not None:
            view = target.calibration.view
            if not self._setup.doing:
                is_homed = view.state == State.HOMED.value != self._before
                self._before = view.state
                if is_homed and self._step.name == "record":  # at once, because it writes nothing
                    self._ask("start_range_recording", "beginning to record")
            if view.state != State.IDLE.value:
                self._setup.saved = None
                if target.test is not None:
                    target.test.forget()
            elif view.is_over:
                self._setup.saved = view.facts["calibration_file"]
        return news

    def _as_shown(self, view: View) -> View:
        """Without what belongs to the next step, once this one is done."""
        done, states = _DONE.get(self._step.name, ("", ()))
        if State(view.state) not in states or view.trouble:
            return view
        return replace(
            view,
            title=self._step.title,
            text=f"{done}. Press Next.",
            rows=(),
            note="",
            offers=tuple(offer for offer in view.offers if offer.command == "restart"),
            picture=view.picture and replace(view.picture, ghost=(), lit=(), note=""),
            is_over=True,
        )

    def _as_it_was(self) -> str:
        target = self._setup.target
        return self._left if target is None else target.situation.untouched


class ChainPage(StepPage):
    """The page of the chain step."""

    def __init__(self, setup: SetupContext) -> None:
        super().__init__(setup, CHAIN, lambda target: target.chain)

    def enter(self) -> None:
        """Verify at once, which writes nothing; not while the chain is still to be made."""
        target = self._setup.target
        if target is None or target.is_under_way:
            return
        now = target.situation
        if now.checked is not None or now.setup.next_joint is not None:
            self._ask("verify", "looking at all six motors")


class FinalTestPage(StepPage):
    """The page of the final test; Stop, Back and Abort end it at any time, with the arm held."""

    def __init__(self, setup: SetupContext) -> None:
        super().__init__(setup, TEST, lambda target: target.test)

    def build(self, gui: viser.GuiApi) -> None:
        text = "This arm cannot be moved from here. You may go on."
        self._unmoved = gui.add_html(cards.instruction(TEST.title, text), visible=False)
        super().build(gui)
        self._save = gui.add_button("Save the report", icon=viser.Icon.DOWNLOAD, color="gray")
        self._setup.context.on_asked(self._save, self._hand_over)

    def leave(self) -> None:
        if self._test is not None:
            self._test.close()

    def show(self) -> None:
        super().show()
        test = self._test
        self._unmoved.visible = test is None
        self._save.visible = test is not None and test.report is not None and not test.is_running

    def next_label(self) -> str:
        report = None if self._test is None else self._test.report
        if self._test is None or (report is not None and report.passed):
            return "Next"
        return "Skip the test" if report is None or report.ended_by else "Go on anyway"

    def can_go_on(self) -> str | None:
        return "the test is running" if self._test is not None and self._test.is_running else None

    def abort(self) -> str:
        self.leave()
        return super().abort()

    def _as_shown(self, view: View) -> View:
        return view  # it is over when what was asked is answered

    def _as_it_was(self) -> str:
        rig = None if self._setup.target is None else self._setup.target.rig
        holds = rig is not None and rig.arm.state.mode in HELD
        where = "the arm is held where it stands" if holds else "the arm is limp, so support it"
        return f"what was saved stays, and {where}"

    @property
    def _test(self) -> MoveTest | None:
        return None if self._setup.target is None else self._setup.target.test

    def _hand_over(self, client: viser.ClientHandle) -> None:
        report = None if self._test is None else self._test.report
        if report is not None:
            name = f"so101-move-test-{report.began_at[:19].replace(':', '')}.json"
            content = report.file({"version": __version__})
            client.send_file_download(name, content, save_immediately=True)


class ConnectionPage(StepPage):
    """The page of the connection step."""

    def __init__(self, setup: SetupContext, source: ArmSource) -> None:
        self._source, self._connect = source, ConnectOperation(source.look, source.instruction)
        super().__init__(setup, CONNECT, left="nothing was changed")

    @property
    def operation(self) -> ConnectOperation:
        return self._connect

    def build(self, gui: viser.GuiApi) -> None:
        super().build(gui)
        self._name = gui.add_text(
            "Arm name (optional)",
            self._setup.progress.arm,
            hint="Such as leader or follower; its calibration gets a file of that name",
            visible=False,
        )
        self._setup.context.on_entry(self._name, self._setup.progress.call)

    def show(self) -> None:
        super().show()
        chosen = self._connect.chosen
        self._name.visible = chosen is not None and chosen.report.calibration is None

    def check(self) -> Check:
        return self._connect.check

    def open(self) -> SetupTarget:
        """Open the target on the chosen port; in a worker's thread."""
        return self._source.open(self._connect.chosen, self._setup.progress.arm)


class ConfigurePage(StepPage):
    """The page of the configuration."""

    def __init__(self, setup: SetupContext) -> None:
        left = "what was saved stays, and the arm is left as it is"
        super().__init__(setup, CONFIGURE, left=left)
        self._text = self._url = ""

    def build(self, gui: viser.GuiApi) -> None:
        context = self._setup.context
        self._about = gui.add_html("")
        self._open = context.button("Open the arm's page", self._preview, icon=viser.Icon.ROBOT)
        self._snippet = gui.add_html("")
        self._keep = gui.add_button("Save it as a file", icon=viser.Icon.DOWNLOAD, color="gray")
        context.on_asked(self._keep, self._hand_over)

    def enter(self) -> None:
        target, self._text = self._setup.target, ""
        if target is not None and self._setup.saved is None:
            self._setup.saved = target.situation.saved
        if target is not None and not target.is_remote:
            make = partial(snippet, target)
            self._setup.do("writing the configuration", make, partial(setattr, self, "_text"))

    def is_next_due(self) -> bool:
        return self._setup.preview is None or bool(self._url)

    def refresh(self) -> bool:
        return False

    def show(self) -> None:
        target, tested = self._setup.target, self._setup.tested
        is_alone = self._setup.preview is not None  # else the page shows the arm already
        if target is None:
            return
        html = cards.instruction(CONFIGURE.title, "")
        if tested is not None:
            html += cards.marked(*MARKS[tested.verdict], tested.sentence, tested.fix)
        if target.is_remote:
            html += cards.instruction(
                "", f"The machine uses it already. Its calibration is in {self._setup.saved}: set"
                " calibration_file of its arm and gripper to that, if it is not."
            )  # fmt: skip
        then = "" if is_alone else "Press Finish, then open the tab Move."
        html += cards.instruction("Move it now", then)
        if self._url:
            to = f'href="{escape(self._url)}" target="_blank" rel="noopener"'
            text = "The preview of the arm, on a page of its own"
            html += f'<div class="so101-card"><a {to}>{text}</a></div>'
        if is_alone:
            html += cards.note(f"Later, from a terminal: {_command(target)}")
        self._about.content = html
        self._open.visible = is_alone and not self._url and not target.is_remote
        self._open.disabled = bool(self._setup.doing)
        about = "For a Viam machine: paste this into Configure, then JSON."
        self._snippet.content = markup.to_copy(about, self._text) if self._text else ""
        self._keep.visible = bool(self._text)

    def _preview(self) -> None:
        target, serve = self._setup.target, self._setup.preview
        if target is not None and serve is not None and not self._url:
            open_page = partial(self._serve, serve, target)
            self._setup.do("opening the arm's page", open_page, partial(setattr, self, "_url"))

    def _serve(self, serve: ServesPreview, target: SetupTarget) -> str:
        """Serve a preview of the arm on a page of its own; returns its link.

        The port is shared, so its page stays when the target is closed.
        """
        file = Path(target.situation.calibration_file)
        asked = ServoSettings(port=target.where, fallback_file=file)
        with ExitStack() as stack:
            rig = open_hardware(asked.with_arm(SERVO_IDS))
            stack.callback(rig.close)
            page = stack.enter_context(serve(rig, port=0, title=f"Arm on {target.where}"))
            self._setup.opened.push(stack.pop_all())
        return page.url_for_once()

    def _hand_over(self, client: viser.ClientHandle) -> None:
        client.send_file_download(
            "so101-viam.json", self._text.encode() + b"\n", save_immediately=True
        )


def _command(target: SetupTarget) -> str:
    if target.is_remote and target.rig is not None:
        _, _, address = target.rig.connection.to.partition(" ")
        return f"so101 view --machine {address}"
    return f"so101 view --port {target.where}"


def snippet(target: SetupTarget) -> str:
    seen = connect.look((target.where,))
    reports = [candidate.report for candidate in seen.candidates]
    return json.dumps(configuration(reports), indent=2)
