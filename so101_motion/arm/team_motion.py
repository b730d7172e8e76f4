"""A plan for several arms that is made once all of them rest, and given up as soon as one is.

Each arm has a motion of its own, as for any other plan. Its planning is one part of this; the last
arm that comes to rest has the plan made. Who stops one of them ends the motions of all.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

from so101_motion.common.errors import Interrupted, MotionError

if TYPE_CHECKING:
    from so101_motion.arm.motion_handle import Motion
    from so101_motion.planning.request import Plan


class TeamPlanning:
    """The planning of one motion of several arms. Any thread may call.

    Args:
        names: The arms.
        plan: Begins to plan for all of them, from where they rest.
        made: Called with the plans before any arm begins.
    """

    def __init__(
        self,
        names: Iterable[str],
        plan: Callable[[], Future[dict[str, Plan]]],
        made: Callable[[Mapping[str, Plan]], None],
    ) -> None:
        self._plan, self._made, self._lock = plan, made, threading.Lock()
        self._parts: dict[str, Future[Plan]] = {name: Future() for name in names}
        self._moving = set(self._parts)
        self._planning: Future[dict[str, Plan]] | None = None
        for name, part in self._parts.items():
            part.add_done_callback(partial(self._given_up, name))

    def part(self, name: str) -> Future[Plan]:
        """The plan of one arm, which rests now; cancelling it gives up those of all."""
        with self._lock:
            is_first = name in self._moving
            self._moving.discard(name)
            is_last = is_first and not self._moving
        if not is_first:
            late: Future[Plan] = Future()
            late.set_exception(
                MotionError("another arm got in the way of the common motion; ask for it again")
            )
            return late
        if is_last and not any(each.done() for each in self._parts.values()):
            try:
                self._planning = self._plan()
            except Exception as error:
                self._end(error)
            else:
                self._planning.add_done_callback(self._hand_out)
        return self._parts[name]

    def watch(self, motions: Mapping[str, Motion]) -> None:
        """End all motions as soon as one ends early."""
        for name, motion in motions.items():
            others = [each for key, each in motions.items() if key != name]
            motion.future.add_done_callback(partial(_end_others, name, others))

    def _hand_out(self, done: Future[dict[str, Plan]]) -> None:
        if done.cancelled():
            return
        error = done.exception()
        if error is not None:
            self._end(error)
            return
        plans = done.result()
        self._made(plans)
        for name, part in self._parts.items():
            with suppress(InvalidStateError):  # one that was given up
                part.set_result(plans[name])

    def _given_up(self, name: str, part: Future[Plan]) -> None:
        if part.cancelled():
            self._end(Interrupted(f"what ended the motion of {name}"))
            if self._planning is not None:
                self._planning.cancel()

    def _end(self, error: BaseException) -> None:
        for part in self._parts.values():
            with suppress(InvalidStateError):
                part.set_exception(error)


def _end_others(name: str, others: list[Motion], done: Future[None]) -> None:
    if done.exception() is not None:
        for each in others:
            each.interrupt(f"what ended the motion of {name}")
