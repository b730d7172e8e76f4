"""Keep the last second of joint states, and pass it to a listener when something fails."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from so101_motion.common.errors import NotReady
from so101_motion.common.state import JointState

_log = logging.getLogger(__name__)

SPAN = 1.0
"""How long a time an error's states cover [s]."""


class RecentStates:
    """The joint states of the last second. Used by the I/O thread only.

    Args:
        dt: The shortest time between two states [s].

    Attributes:
        on_failure: Called with each failure and the states before it; must be brief.
    """

    def __init__(self, dt: float) -> None:
        self.on_failure: Callable[[Exception, tuple[JointState, ...]], None] | None = None
        self._states: deque[JointState] = deque(maxlen=1 + round(SPAN / dt))
        self._notified: Exception | None = None

    def append(self, state: JointState) -> None:
        """Add the newest state; it replaces one of the same time."""
        if self._states and self._states[-1].t == state.t:
            self._states.pop()
        self._states.append(state)

    def last_second(self) -> tuple[JointState, ...]:
        """The states of the last second, oldest first; the first is the one that held then."""
        since = self._states[-1].t - SPAN if self._states else 0.0
        before = [state for state in self._states if state.t < since]
        held = (replace(before[-1], t=since),) if before else ()
        return (*held, *(state for state in self._states if state.t >= since))

    def notify(self, error: Exception, recent: tuple[JointState, ...]) -> None:
        """Pass an error to ``on_failure``, once."""
        is_new = error is not self._notified and not isinstance(error, NotReady)
        if self.on_failure is not None and is_new:
            self._notified = error
            try:
                self.on_failure(error, recent)
            except Exception:
                _log.exception("a failure was not recorded; the joints are not affected")
