"""Where the page's arm comes from, and looking for it until it is there.

The page opens before the arm does: a port may have nothing on it yet, a machine may be starting.
Once found, an arm that goes away is not looked for here: its rig knows how to come back.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from so101_motion.errors import So101Error
from so101_motion.rig_like import RigLike

log = logging.getLogger(__name__)

LOOK_AGAIN = 2.0
"""How long until an arm that was not there is looked for again [s]; chosen: one is plugged in, and
the page shows it before one has sat down."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Where an arm comes from.

    Attributes:
        title: Which arm it is, in words that can stand alone: ``"Arm on /dev/ttyACM0"``.
        open: Makes the rig; raises ``So101Error`` while that is not possible.
        lasts: Whether the rig goes on when the page is closed; else the page closes it.
        scene_file: The file its surroundings are from, where the page saves them again.
    """

    title: str
    open: Callable[[], RigLike]
    lasts: bool = False
    scene_file: Path | None = None

    @classmethod
    def given(cls, rig: RigLike, title: str) -> Source:
        """A rig that is there already and stays its owner's."""
        return cls(title=title, open=lambda: rig, lasts=True)


class Search:
    """Tries to open a source again and again, on a thread of its own, until it succeeds.

    Args:
        source: What to open.
        found: Takes the rig; called once, on that thread.
        failed: Told why each try failed, likewise.
    """

    def __init__(
        self,
        source: Source,
        *,
        found: Callable[[RigLike], None],
        failed: Callable[[Exception], None],
    ) -> None:
        self._source, self._found, self._failed = source, found, failed
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="so101-viewer-search", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Give up; a try under way is waited for, and what it finds is closed again."""
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._over.is_set():
            try:
                rig = self._source.open()
            except Exception as error:
                if not isinstance(error, So101Error):
                    log.exception("the arm could not be opened")
                self._failed(error)
                self._over.wait(LOOK_AGAIN)
                continue
            if self._over.is_set():
                rig.close()
            else:
                self._found(rig)
            return
