"""Save the joint states of the last second before a failure to a file.

The error of a failed motion says in one sentence why. The states of the second before, one for each
cycle, show how it came about. They are written to a folder of the user's; the newest ``KEPT`` stay:

    ~/.local/share/so101_motion/failures/20260511T101112Z-0001-FollowingError.json

The port's thread only chooses the name, for a note of the error. Another thread writes the file:
that takes milliseconds, which the port's thread does not have.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

from so101_motion.common.errors import ConfigError, FollowingError
from so101_motion.common.geometry import Array
from so101_motion.common.state import GRIPPER_JOINT, JointState
from so101_motion.common.units import to_deg
from so101_motion.files import atomic, user_storage

_log = logging.getLogger(__name__)

SCHEMA = "so101/failure/1"

KEPT = 20  # How many records are kept; one has about 60 kB at 100 Hz. Chosen.

_numbers = itertools.count(1)


def folder() -> Path:
    """The folder of the records; ``ConfigError`` if this user has no home."""
    return user_storage.folder() / "failures"


def newest() -> tuple[Path, ...]:
    try:
        found = folder().glob("*.json")
    except ConfigError:
        return ()
    return tuple(sorted((path for path in found if path.name[:1] != "."), reverse=True))


class FailureRecorder:
    """Saves the states before each failure. Used by the I/O thread, except ``latest``.

    Args:
        source: Where the failures happen, such as the name of the port.

    Attributes:
        latest: The newest record; None before the first failure.
    """

    def __init__(self, source: str) -> None:
        self.latest: Path | None = None
        self._source = source
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="so101-record")

    def record(self, error: Exception, states: tuple[JointState, ...]) -> None:
        """Write ``states`` on another thread; a note of ``error`` names the file."""
        is_of_jaw = isinstance(error, FollowingError) and error.joint == GRIPPER_JOINT
        if not states or (is_of_jaw and states[-1].q_jaw > states[-1].q_jaw_ref):
            return  # a jaw that is kept from closing is no failure: so every grip begins
        now = datetime.now(UTC)
        name = f"{now:%Y%m%dT%H%M%SZ}-{next(_numbers):04}-{type(error).__name__}.json"
        try:
            path = folder() / name
        except ConfigError:
            return
        content = {"written": now.isoformat(), "source": self._source, "error": str(error)}
        error.add_note(f"The second before is recorded in {path}")
        _log.info("The second before is recorded in %s: %s", path, error)
        self.latest = path
        self._writer.submit(_write, path, content, states)

    def close(self) -> None:
        self._writer.shutdown()


def _write(path: Path, content: Mapping[str, object], states: tuple[JointState, ...]) -> None:
    rows = [_row(state, states[-1].t) for state in states]
    try:
        user_storage.write(path, {**content, "states": rows}, schema=SCHEMA)
        with atomic.locked(path.parent):
            for old in newest()[KEPT:]:
                old.unlink(missing_ok=True)
    except (ConfigError, OSError) as error:
        _log.warning("the second before a failure could not be kept: %s", error)


def _row(state: JointState, end: float) -> dict[str, object]:
    reading = state.reading
    return {
        "t_s": round(state.t - end, 4),
        "state": state.mode.value,
        "q_deg": _degrees(reading.q),
        "q_ref_deg": _degrees(state.q_ref),
        "qd_degs_per_sec": _degrees(reading.qd),
        "qd_ref_degs_per_sec": _degrees(state.qd_ref),
        "jaw_deg": round(to_deg(reading.q_jaw), 3),
        "jaw_ref_deg": round(to_deg(state.q_jaw_ref), 3),
        "late_ticks": state.late_ticks,
        "alarms": dict(reading.alarms),
        "unanswered": sorted(reading.unanswered),
    }


def _degrees(angles: Array) -> list[float]:
    return [round(float(angle), 3) for angle in to_deg(angles)]
