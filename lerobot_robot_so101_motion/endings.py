"""Disconnect every arm when the program ends, also after SIGTERM or an early error.

LeRobot's commands disconnect after Ctrl-C and after most errors, but not after SIGTERM or an error
before their loop. So while an arm is connected, SIGTERM ends the program as Ctrl-C does, unless the
program has a handler for it; and an arm that is still connected at the exit is disconnected then.
"""

from __future__ import annotations

import atexit
import logging
import signal
import threading
from collections.abc import Callable
from types import FrameType

_log = logging.getLogger(__name__)

_connected: list[Ending] = []


class Ending:
    """Disconnects one robot at the end of the program, if it is connected then.

    Args:
        disconnect: Disconnects the robot.
    """

    def __init__(self, disconnect: Callable[[], None]) -> None:
        self.disconnect = disconnect

    def attend(self) -> None:
        """Note that the robot is connected now."""
        if self not in _connected:
            _connected.append(self)
        if _may_set_handlers() and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
            signal.signal(signal.SIGTERM, _end)

    def leave(self) -> None:
        """Note that the robot is no longer connected."""
        if self in _connected:
            _connected.remove(self)
        is_ours = _may_set_handlers() and signal.getsignal(signal.SIGTERM) is _end
        if is_ours and not _connected:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _may_set_handlers() -> bool:
    return threading.current_thread() is threading.main_thread()


def _end(number: int, _frame: FrameType | None) -> None:
    raise SystemExit(128 + number)


@atexit.register
def _disconnect_all() -> None:
    for ending in tuple(_connected):
        try:
            ending.disconnect()
        except Exception as error:  # go on with the other arms
            _log.warning("an arm could not be disconnected properly: %s", error)
