"""Follow apertures that are given while the jaw moves, and grip what it closes on.

An object that stops a closing jaw makes it fall behind its setpoints. It then presses with a steady
force instead of ever harder, however far it is to close (see ``gripper.py``). When it is to open
farther than it stands, or the object has slipped out, it follows again.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TYPE_CHECKING

from so101_motion.common.errors import ConfigError, FollowingError, Interrupted, MotionError
from so101_motion.common.geometry import is_finite
from so101_motion.control.following import Following
from so101_motion.control.open_ended_motion import EndsWithBlock
from so101_motion.control.request_queue import running_future

if TYPE_CHECKING:
    from so101_motion.arm.gripper import Gripper

LET_GO = 0.03
"""A grip ends when the wanted aperture is wider than the jaw by this share of the travel; chosen:
more than a hand on a trigger trembles."""


class JawFollowing(EndsWithBlock):
    """A jaw that follows apertures; made by ``Gripper.follow``.

    Args:
        gripper: Whose jaw.
        begin: Starts a following from where the jaw is.
        halt: ``halt(future, by)`` ends a motion of the jaw.

    Attributes:
        future: Completes when the jaw is at rest after ``close``, or raises why it ended earlier.
    """

    def __init__(
        self,
        gripper: Gripper,
        begin: Callable[[JawFollowing], Following],
        halt: Callable[[Future[None], str], object],
    ) -> None:
        self.future: Future[None] = running_future()
        self._gripper, self._begin, self._halt = gripper, begin, halt
        self._lock = threading.RLock()  # a following that ends at once calls back at once
        self._wanted: float | None = None
        self._grip: Future[None] | None = None  # completes when it presses; None while it follows
        self._closing = False
        self._follow()

    # Any thread

    def aim(self, aperture: float, rate: float = 0.0) -> float:
        """Open or close to an aperture, from the next control cycle on; never waits.

        Args:
            aperture: How far, 0 closed to 1 open.
            rate: How fast that changes, shares of the travel [1/s].

        Returns:
            The aperture as it was taken, within 0 to 1.

        Raises:
            ConfigError: These are not finite numbers; the aperture before stays.
            So101Error: The following has ended; the error says why.
        """
        try:
            values = [float(aperture), float(rate)]
        except (TypeError, ValueError) as error:
            raise ConfigError("aperture", aperture, "must be a number from 0 to 1") from error
        if not is_finite(values):
            raise ConfigError("aperture", aperture, "must be finite, and so must its rate")
        taken = min(max(values[0], 0.0), 1.0)
        with self._lock:
            self._refuse_if_over()
            self._wanted = taken
            if self._grip is not None:
                if not self._is_to_let_go(taken, self._grip):
                    return taken
                self._follow()
            gripper = self._gripper
            span = gripper.opened - gripper.closed
            self._following.aim([gripper.closed + taken * span], [values[1] * span])
        return taken

    def hold(self, *, briefly: bool = False) -> None:
        """Slow to rest and wait for the next aperture; a grip stays. Never waits.

        Args:
            briefly: As for ``Following.hold``.
        """
        with self._lock:
            self._following.hold(briefly=briefly)

    def regrip(self) -> None:
        """Press again on what is gripped, after the joints were held anew."""
        if self._grip is not None:
            self._gripper.regrip()

    def close(self) -> Future[None]:
        """Come to rest and end; what is gripped stays gripped. May be called again."""
        with self._lock:
            self._closing = True
            if self._grip is None:
                self._following.close()
            elif not self.future.done():
                self.future.set_result(None)
        return self.future

    @property
    def is_gripping(self) -> bool:
        """Whether it has closed on something that is still there."""
        return self._grip is not None and self._gripper.is_holding

    def interrupt(self, by: str) -> None:
        """End it early, at once when it grips, with ``Interrupted(by)``."""
        with self._lock:
            if self._grip is None:
                self._halt(self._following.future, by)
            else:
                self._end(Interrupted(by))

    # How

    def _is_to_let_go(self, wanted: float, grip: Future[None]) -> bool:
        gripper = self._gripper
        return wanted > gripper.aperture + LET_GO or (grip.done() and not gripper.is_holding)

    def _follow(self) -> None:
        with self._lock:  # the I/O thread may ask for an aperture at once
            self._grip = None
            self._following = self._begin(self)
            self._following.future.add_done_callback(self._ended)

    def _ended(self, done: Future[None]) -> None:
        """Grip, or end, because the following has ended; called on the I/O thread."""
        with self._lock:
            if done is not self._following.future:
                return
            error, wanted = done.exception(), self._wanted
            closes = wanted is not None and wanted < self._gripper.aperture + LET_GO
            if isinstance(error, FollowingError) and closes and not self._closing:
                self._grip = self._gripper.press()
            else:
                self._end(error)

    def _end(self, error: BaseException | None) -> None:
        if self.future.done():
            return
        if error is None:
            self.future.set_result(None)
        else:
            self.future.set_exception(error)

    def _refuse_if_over(self) -> None:
        if self.future.done():
            error = self.future.exception()
            if error is not None:
                raise error
        if self._closing or self.future.done():
            raise MotionError("the following has been closed; open a new one")
