"""The log of what happened on a page."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from datetime import datetime

from .screen_state import Tone

KEPT = 500  # how many events are remembered; chosen: a day of work


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """One event in the log, at a local time; the text is a sentence without a full stop."""

    at: datetime
    text: str
    tone: Tone

    def __str__(self) -> str:
        return f"{self.at:%Y-%m-%d %H:%M:%S} {self.text}"


class EventLog:
    """The last ``KEPT`` events, and a count of all; any thread may use it."""

    def __init__(self) -> None:
        self.count = 0
        self._lock = threading.Lock()
        self._events: deque[Event] = deque(maxlen=KEPT)

    def add(self, text: str, tone: Tone = Tone.PLAIN) -> None:
        """Log ``text`` now; the same text within a second counts as one event."""
        event = Event(at=datetime.now(), text=text.rstrip("."), tone=tone)
        with self._lock:
            if self._events:
                last = self._events[-1]
                if last.text == event.text and (event.at - last.at).total_seconds() < 1.0:
                    return
            self._events.append(event)
            self.count += 1

    def newest(self, most: int = KEPT) -> list[Event]:
        with self._lock:
            return list(self._events)[: -most - 1 : -1]

    def text(self) -> str:
        return "".join(f"{event}\n" for event in reversed(self.newest()))
