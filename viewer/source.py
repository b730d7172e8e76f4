"""Open the page's arm or arms in the background, trying again until they are there.

Once opened, an arm that disconnects is not opened again here: its rig reconnects by itself.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from so101_motion.common.errors import So101Error
from so101_motion.rig.cell_rigs import CellRigs
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig

if TYPE_CHECKING:
    from so101_motion.tasks.sweeps.atlas import Atlas

log = logging.getLogger(__name__)

LOOK_AGAIN = 2.0  # how long until an arm that was not found is looked for again [s]; chosen


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Describes how to open an arm, or several that share a space.

    Attributes:
        title: Which they are, in words that can stand alone: ``"Arm on /dev/ttyACM0"``.
        open: Opens them; raises ``So101Error`` while that is not possible.
        lasts: Whether they stay open when the page is closed; else the page closes them.
        scene_file: The file that the surroundings, or several arms, are from; the page saves them
            there again. Among the user's own files if not given.
        camera: A camera's device or address, or a machine's name of it; or None.
        atlas: What a single arm reaches, to be shown, or None.
        open_leader: Opens the arm that a single one may follow; None if there is none.
        place: Where the page proposes to put items.
    """

    title: str
    open: Callable[[], RigLike | CellRigs]
    lasts: bool = False
    scene_file: Path | None = None
    camera: str | None = None
    atlas: Atlas | None = None
    open_leader: Callable[[], Rig] | None = None
    place: str = ""

    @classmethod
    def given(cls, rig: RigLike, title: str) -> Source:
        """A source of a rig that is open already; its owner closes it."""
        return cls(title=title, open=lambda: rig, lasts=True)


class SourceOpener:
    """Opens a source on a thread of its own, again and again until it succeeds."""

    def __init__(
        self,
        open: Callable[[], RigLike | CellRigs],
        *,
        found: Callable[[RigLike | CellRigs], None],
        failed: Callable[[Exception], None],
    ) -> None:
        self._open, self._found, self._failed = open, found, failed
        self.closing, self.tried = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="so101-viewer-search", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop trying; waits for a running attempt and closes what it opened."""
        self.closing.set()
        self._thread.join()

    def _run(self) -> None:
        while not self.closing.is_set():
            try:
                opened = self._open()
            except Exception as error:
                if not isinstance(error, So101Error):
                    log.exception("the arm could not be opened")
                self._failed(error)
                self.tried.set()
                self.closing.wait(LOOK_AGAIN)
                continue
            if self.closing.is_set():
                opened.close()
            else:
                self._found(opened)
            self.tried.set()
            return
