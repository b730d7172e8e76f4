"""Decide which of several browser windows is in control.

The first window has control. Another may ask for it: the window in control hands it over or keeps
it, and after ``PATIENCE`` without an answer it is handed over. When the window in control closes,
the window that asks takes over, else the next one that opens or presses something. Stop needs no
control. Any thread may call.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

PATIENCE = 15.0
"""How long the window in control has to answer [s]; chosen: time to read a sentence and decide."""


class Role(Enum):
    """The role of a window."""

    IN_CONTROL = auto()
    ASKED = auto()  # in control, and somebody else wants to be
    WATCHING = auto()
    ASKING = auto()
    FREE = auto()  # nobody is in control; the next press takes it


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowStatus:
    """The state of a window.

    Attributes:
        role: Its role.
        other: The number of the other window: the one in control, or the one that asks; else None.
        seconds: How long the window in control may take to answer, rounded up; 0 if nobody asks.
    """

    role: Role
    other: int | None = None
    seconds: int = 0


class WindowControl:
    """Knows the windows, the one in control, and the one that asks for it.

    Args:
        now: The time [s].
        tell: Called with a sentence for each change, from the thread that made it.
    """

    def __init__(self, now: Callable[[], float], tell: Callable[[str], None]) -> None:
        self._now, self._tell = now, tell
        self._lock = threading.RLock()
        self._windows: list[int] = []
        self._holder: int | None = None
        self._asking: int | None = None
        self._due = 0.0

    @property
    def windows(self) -> tuple[int, ...]:
        """The numbers of all windows, the oldest first."""
        return tuple(self._windows)

    def join(self, window: int) -> None:
        """Add a window that has opened."""
        with self._lock:
            self._windows.append(window)
            if self._holder is None:
                self._holder = window
                if len(self._windows) > 1:
                    self._tell(f"Window {window} has control")

    def leave(self, window: int) -> None:
        """Remove a window that has closed."""
        with self._lock:
            if window not in self._windows:
                return
            self._windows.remove(window)
            if self._asking == window:
                self._asking = None
            if self._holder == window:
                self._holder = None
                if self._asking is not None:
                    self._give(self._asking)

    def may_act(self, window: int) -> bool:
        """Whether ``window`` may act now; takes control if no window has it."""
        with self._lock:
            if self._holder is None and window in self._windows:
                self._give(window)
            return self._holder == window

    def ask(self, window: int) -> None:
        """Ask for control on behalf of a window."""
        with self._lock:
            if self.may_act(window) or window not in self._windows or self._asking is not None:
                return
            self._asking, self._due = window, self._now() + PATIENCE
            self._tell(f"Window {window} asked for control")

    def answer(self, window: int, *, allow: bool) -> None:
        """Give control away, or refuse to, for the window in control."""
        with self._lock:
            if self._holder != window or self._asking is None:
                return
            asking, self._asking = self._asking, None
            if allow:
                self._give(asking)
            else:
                self._tell(f"Window {window} kept control")

    def tick(self) -> None:
        """Give control to the asking window after a long silence."""
        with self._lock:
            if self._asking is not None and self._now() >= self._due:
                self._give(self._asking)

    def status(self, window: int) -> WindowStatus:
        """The state of ``window``."""
        with self._lock:
            left = math.ceil(max(self._due - self._now(), 0.0)) if self._asking is not None else 0
            if self._holder == window:
                if self._asking is None:
                    return WindowStatus(role=Role.IN_CONTROL)
                return WindowStatus(role=Role.ASKED, other=self._asking, seconds=left)
            if self._holder is None:
                return WindowStatus(role=Role.FREE)
            role = Role.ASKING if self._asking == window else Role.WATCHING
            return WindowStatus(role=role, other=self._holder, seconds=left)

    def _give(self, window: int) -> None:
        self._holder, self._asking = window, None
        self._tell(f"Window {window} has control")
