"""Let the arm be guided by hand for a limited time, then hold it again."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from so101_motion.arm.arm import Arm
from so101_motion.common.clock import Clock
from so101_motion.common.modes import Mode

GUIDED_FOR = 180.0  # how long the arm yields to a hand before it holds again by itself [s]; chosen


class Guiding:
    """Lets an arm be guided by hand for a limited time. For the page's thread."""

    def __init__(
        self, arm: Arm, clock: Clock, submit: Callable[[Callable[[], Any]], Future[Any]]
    ) -> None:
        self._arm, self._clock, self._submit = arm, clock, submit
        self._switching: Future[None] | None = None
        self._until: float | None = None

    @property
    def is_on(self) -> bool:
        """Whether the arm is guided by hand, started here or elsewhere."""
        return self._arm.state.mode is Mode.GUIDING

    @property
    def left(self) -> float | None:
        """The time left [s]; None when there is no limit, or it is over."""
        return None if self._until is None else self._until - self._clock.now()

    def start(self) -> None:
        if self._switching is None and self._arm.state.mode in (Mode.HOLDING, Mode.LIMP):
            self._until = self._clock.now() + GUIDED_FOR
            self._switching = self._submit(lambda: self._arm.set_manual(True))

    def refresh(self) -> bool:
        """Return whether the time has just run out; raises what switching has failed with."""
        if self._switching is not None:
            if not self._switching.done():
                return False
            switching, self._switching = self._switching, None
            if switching.exception() is not None:
                self._until = None
                switching.result()
        if self._until is None:
            return False
        if not self.is_on:
            self._until = None  # somebody else has ended it
            return False
        if self._clock.now() < self._until:
            return False
        self._until = None
        self._switching = self._submit(lambda: self._arm.set_manual(False))
        return True
