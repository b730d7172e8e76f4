"""Identify the servos of the page's arm: plan, move once a person agrees, keep the figures.

Planning moves nothing. The motions run on a thread of their own, and Stop ends them like any other
motion. The figures are kept beside the calibration and used at once.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from so101_motion.common.errors import CalibrationError, So101Error
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.setup.identify import Identification, IdentificationOutline
from so101_motion.setup.identify_report import IdentifyReport


class Identifying:
    """Runs one identification after the other.

    Args:
        rig: The arm, on a port of this computer.

    Attributes:
        outline: What will move; None until it was planned, and once it has moved.
        doing: What is under way, for people; empty when idle.
        report: The last result.
        trouble: Why the last one failed.
    """

    def __init__(self, rig: HardwareRig) -> None:
        self._rig = rig
        self._identification: Identification | None = None
        self._thread: threading.Thread | None = None
        self.outline: IdentificationOutline | None = None
        self.doing = ""
        self.report: IdentifyReport | None = None
        self.trouble: BaseException | None = None

    def plan(self) -> None:
        """Begin to plan the motions; nothing moves."""
        self._begin(self._plan, "Planning")

    def move(self, *, carrying: bool) -> None:
        """Begin the motions that were outlined; without an outline nothing happens.

        Args:
            carrying: Whether the hand carries something that is to be weighed.
        """
        outline = self.outline
        if outline is not None:
            self._begin(lambda: self._move(outline, carrying), "Raising the arm")

    def close(self) -> None:
        """End what is under way; returns when the arm is at rest."""
        if self._identification is not None:
            self._identification.cancel()
        self.wait()

    def wait(self) -> None:
        """Return when nothing is under way."""
        if self._thread is not None:
            self._thread.join()

    def _begin(self, job: Callable[[], None], doing: str) -> None:
        if self.doing:
            return
        self.doing, self.trouble = doing, None

        def run() -> None:
            try:
                job()
            except (So101Error, OSError) as error:
                self.trouble = error
            finally:
                self.doing = ""

        self._thread = threading.Thread(target=run, name="so101-viewer-identify")
        self._thread.start()

    def _plan(self) -> None:
        if self._rig.settings.file is None:
            raise CalibrationError(
                None,
                "this arm has no calibration file, and the figures belong beside one",
                "calibrate it",
            )
        self._identification = Identification(self._rig)
        self.outline = self._identification.outline()

    def _move(self, outline: IdentificationOutline, carrying: bool) -> None:
        identification = self._identification
        assert identification is not None  # it made the outline
        self.outline = self.report = None
        identification.move_and_record(outline, self._tell)
        self.doing = "Computing"
        self.report = identification.report(hand_is_empty=not carrying, keeps=True)
        self._rig.reload()

    def _tell(self, joint: str, share: float) -> None:
        self.doing = f"Moving {joint}, {share:.0%} done"
