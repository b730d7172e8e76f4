"""The last page: the configuration for Viam, and the page of the calibrated arm."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import viser

from so101_motion.drivers.bus.defaults import SERVO_IDS
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.servo_driver import ServoSettings
from so101_motion.setup import port_selection
from so101_motion.setup.setup_steps import CONFIGURE
from so101_motion.viam.suggested_config import configuration

from ..page import cards, markup
from . import setup_cards
from .page import StepPage
from .setup_context import ServesPreview, SetupContext
from .setup_target import SetupTarget


def _serve(serve: ServesPreview, target: SetupTarget) -> tuple[str, Callable[[], None]]:
    """Serve a preview of the arm on a page of its own; returns its link, and what ends it.

    The port is shared, so its page stays when the target is closed.
    """
    file = Path(target.situation.calibration_file)
    asked = ServoSettings(port=target.where, fallback_file=file)
    with ExitStack() as stack:
        rig = open_hardware(asked.with_arm(SERVO_IDS))
        stack.callback(rig.close)
        page = serve(rig, port=0, title=f"Arm on {target.where}")
        stack.callback(page.close)
        return page.url_for_once(), stack.pop_all().close


class ConfigurePage(StepPage):
    """The page of the configuration."""

    def __init__(self, setup: SetupContext) -> None:
        left = "what was saved stays, and the arm is left as it is"
        super().__init__(setup, CONFIGURE, left=left)
        self._text = self._url = ""

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        self._about = gui.add_html("")
        self._ways = gui.add_html("")
        self._open = gui.add_button("Open the arm's page", icon=viser.Icon.ROBOT, visible=False)
        self._snippet = gui.add_html("")
        self._keep = gui.add_button(
            "Save it as a file", icon=viser.Icon.DOWNLOAD, color="gray", visible=False
        )
        self._setup.context.on_press(self._open, self._preview)
        self._setup.context.on_asked(self._keep, self._hand_over)

    def enter(self) -> None:
        """Make the configuration for the target."""
        target, self._text = self._setup.target, ""
        if target is not None and self._setup.saved is None:
            self._setup.saved = target.situation.saved
        if target is not None and not target.is_remote:
            make = partial(snippet, target)
            self._setup.do("writing the configuration", make, self._take)

    def refresh(self) -> bool:
        """Nothing is new but what the worker has done."""
        return False

    def show(self) -> None:
        """Show the configuration, and the link to its page."""
        target = self._setup.target
        if target is None:
            return
        saved = self._setup.saved
        tested = self._setup.tested
        html = cards.instruction(CONFIGURE.title, "")
        html += "" if tested is None else setup_cards.check_text(tested)
        if target.is_remote:
            html += cards.instruction(
                "", f"The machine uses it already. Its calibration is in {saved}: set"
                " calibration_file of its arm and gripper to that, if it is not."
            )  # fmt: skip
        self._about.content = html
        about = "For a Viam machine: paste this into Configure, then JSON."
        self._snippet.content = markup.to_copy(about, self._text) if self._text else ""
        self._keep.visible = bool(self._text)
        self._show_preview_link(target)

    def _show_preview_link(self, target: SetupTarget) -> None:
        if self._setup.preview is None:
            self._ways.content = cards.instruction(
                "Move it now", "Press Finish, then open the tab Move."
            )
            return
        self._open.visible = not self._url and not target.is_remote
        self._open.disabled = bool(self._setup.doing)
        html = cards.instruction("Move it now", "")
        if self._url:
            html += setup_cards.link(self._url, "The preview of the arm, on a page of its own")
        self._ways.content = html + cards.note(f"Later, from a terminal: {_command(target)}")

    def _preview(self) -> None:
        target, serve = self._setup.target, self._setup.preview
        if target is not None and serve is not None and not self._url:
            open_page = partial(_serve, serve, target)
            self._setup.do("opening the arm's page", open_page, self._show_preview)

    def _show_preview(self, served: tuple[str, Callable[[], None]]) -> None:
        self._url, close = served
        self._setup.opened.callback(close)

    def _take(self, text: str) -> None:
        self._text = text

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
    """The configuration of the arm on the target's port for viam-server, as JSON."""
    seen = port_selection.look((target.where,))
    reports = [candidate.report for candidate in seen.candidates]
    return json.dumps(configuration(reports), indent=2)
