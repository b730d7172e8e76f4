"""The last page: what to do with an arm that is calibrated."""

from __future__ import annotations

import json

import viser

from so101_motion import adapters
from so101_motion.configuration import configuration
from so101_motion.hardware_config import SERVO_IDS
from so101_motion.rig import open_hardware
from so101_motion.servos import ServoSettings
from so101_motion.workflow import CONFIGURE

from ..desk import Desk
from . import calibrating, calibration_cards, cards
from .bench import Bench
from .page import StepPage
from .workshop import Workshop


class Outlook:
    """The preview of an arm that was set up, on a page of its own on this computer.

    Args:
        bench: Whose arm. The port is shared, so the preview stays when the bench is put away.

    Attributes:
        url: A link that opens it, once.

    Raises:
        So101Error: The arm cannot be held, or the page cannot be served.
    """

    def __init__(self, bench: Bench) -> None:
        from ..app import serve  # it has the setup as one of its tabs

        file = bench.calibrator.situation.calibration_file
        asked = ServoSettings(port=bench.where, fallback_file=file)
        self._rig = open_hardware(asked.with_arm(SERVO_IDS))
        try:
            self._page = serve(self._rig, port=0, title=f"Arm on {bench.where}")
        except BaseException:
            self._rig.close()
            raise
        self.url = self._page.url_for_once()

    def close(self) -> None:
        """Stop serving it."""
        self._page.close()
        self._rig.close()


class ConfigurePage(StepPage):
    """The page of the configuration.

    Args:
        shop: What all pages share.
    """

    def __init__(self, shop: Workshop) -> None:
        super().__init__(shop, CONFIGURE)
        self._text = self._url = ""
        self._is_shown = False

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        self._about = gui.add_html("")
        self._snippet = gui.add_html("")
        self._keep = gui.add_button(
            "Save it as a file", icon=viser.Icon.DOWNLOAD, color="gray", visible=False
        )
        self._ways = gui.add_html("")
        self._open = gui.add_button("Open the preview", icon=viser.Icon.ROBOT, visible=False)
        self._shop.desk.on_press(self._open, self._preview)
        self._shop.desk.on_asked(self._keep, self._hand_over)

    def enter(self) -> None:
        """Make the configuration of what is on the bench."""
        bench, self._text, self._is_shown = self._shop.bench, "", False
        if bench is not None and self._shop.saved is None:
            self._shop.saved = calibrating.saved_before(bench.calibrator.situation)
        if bench is not None and not bench.is_remote:
            self._do("writing the configuration", snippet, self._take)

    def refresh(self) -> bool:
        """Whether there is something new to show."""
        before, self._is_shown = self._is_shown, True
        return not before

    def show(self) -> None:
        """Show the configuration, and where the arm can be moved."""
        bench = self._shop.bench
        if bench is None:
            return
        saved = self._shop.saved
        tested = self._shop.tested
        said = cards.instruction(CONFIGURE.title, "")
        said += "" if tested is None else cards.said(tested)
        if bench.is_remote:
            said += cards.instruction(
                "", f"The machine has it in force already. Its calibration is in {saved}: give its"
                " arm and gripper this calibration_file, if they have not."
            )  # fmt: skip
        else:
            said += cards.instruction(
                "", "For a Viam machine: paste this into Configure, then JSON. A click selects all"
                " of it."
            )  # fmt: skip
        self._about.content = said
        self._snippet.content = calibration_cards.to_copy(self._text) if self._text else ""
        self._keep.visible = bool(self._text)
        self._show_ways(bench)

    def _show_ways(self, bench: Bench) -> None:
        if isinstance(self._shop.desk, Desk):
            self._ways.content = cards.instruction(
                "Move it now", "Press Finish, then open the tab Move."
            )
            return
        self._open.visible = not self._url and not bench.is_remote
        self._open.disabled = bool(self._shop.doing)
        said = cards.instruction("Move it now", "")
        if self._url:
            said += calibration_cards.link(
                self._url, "The preview of the arm, on a page of its own"
            )
        self._ways.content = said + cards.note(f"Later, from a terminal: {_command(bench)}")

    def _as_it_was(self) -> str:
        return "what was saved stays, and the arm is left as it is"

    def _preview(self) -> None:
        if not self._url:
            self._do("opening the preview", Outlook, self._show_preview)

    def _show_preview(self, outlook: Outlook) -> None:
        self._shop.opened.append(outlook)
        self._url, self._is_shown = outlook.url, False

    def _take(self, text: str) -> None:
        self._text, self._is_shown = text, False

    def _hand_over(self, client: viser.ClientHandle) -> None:
        client.send_file_download(
            "so101-viam.json", self._text.encode() + b"\n", save_immediately=True
        )


def _command(bench: Bench) -> str:
    if bench.is_remote and bench.rig is not None:
        _, _, address = bench.rig.connection.to.partition(" ")
        return f"so101 view --machine {address}"
    return f"so101 view --port {bench.where}"


def snippet(bench: Bench) -> str:
    """What viam-server is to be told of the arm on the bench's port, as JSON."""
    seen = adapters.look((bench.where,))
    reports = [candidate.report for candidate in seen.candidates]
    return json.dumps(configuration(reports), indent=2)
