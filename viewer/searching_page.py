"""A page that is served at once, and shows its arms when they are found."""

from __future__ import annotations

from abc import abstractmethod

import viser

from so101_motion.rig.cell_rigs import CellRigs
from so101_motion.rig.protocols import RigLike

from .page import markup
from .page.screen_state import Sentence
from .panels.hold_buttons import waiting
from .server.guarded_server import GuardedServer
from .server.host import ServedPage
from .source import Source, SourceOpener

_WAITS = Sentence(
    text="This page keeps looking for the arm, and shows it here as soon as it answers. Nothing"
    " moves. Meanwhile check:"
)
_CHECK = (
    ("Power", "the arm's own supply is switched on: USB does not feed the motors"),
    ("Cable", "the USB cable is plugged in at both ends"),
    ("Port", "no other program has it open"),
    ("Machine", "if the arm is one of a machine: it runs, and its address is right"),
)


class SearchingPage(ServedPage):
    """A page that is served at once, and shows its arms as soon as they can be opened.

    Args:
        source: What is shown.
    """

    def __init__(self, source: Source, server: GuardedServer) -> None:
        super().__init__(server)
        self._source = source
        self._opened: RigLike | CellRigs | None = None
        self._search: SourceOpener | None = None
        self._waits: viser.GuiHtmlHandle | None = None
        self.host.say = self._missed
        if source.lasts:
            self._take(source.open())
        else:
            waiting(self.host.bar, source.title)
            about = markup.sentence(_WAITS, is_whole=True) + markup.facts(_CHECK)
            self._waits = self.host.gui.add_html(about)
        self.host.start()
        if not source.lasts:
            self._search = SourceOpener(source.open, found=self._found, failed=self._missed)

    def close(self) -> None:
        """Stop serving. What was passed in stays open; what was opened is closed."""
        if self._search is not None:
            self._search.close()
        self.host.close()
        opened, self._opened = self._opened, None
        if opened is not None and not self._source.lasts:
            opened.close()

    def _missed(self, error: Exception) -> None:
        self.host.post(lambda: waiting(self.host.bar, self._source.title, error))

    def _found(self, opened: RigLike | CellRigs) -> None:
        self._opened = opened
        self.host.post(lambda: self._take(opened))

    def _take(self, opened: RigLike | CellRigs) -> None:
        self._opened = opened
        if self._waits is not None:
            self._waits.remove()
        self._add_parts(opened)
        self.host.events.add(f"{self._source.title}: connected")

    @abstractmethod
    def _add_parts(self, opened: RigLike | CellRigs) -> None:
        """Add the parts that show what was opened."""
