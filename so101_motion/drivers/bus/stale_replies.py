"""Tell the reply to a question from late replies to earlier questions.

Only the length of a reply depends on the question: a servo can be asked for more bytes than are
needed. So while a reply is overdue, the next question to that servo uses another length, and the
stale reply is skipped when it comes. Some adapters also deliver a reply twice. So when a question
differs from the one before, copies of the last replies are expected as well. (A control cycle
repeats the same question; a copy of its reply would merely be old.)
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection

from so101_motion.drivers.bus.registers import END

OVERDUE = 0.25
"""How long a missing reply may still come [s]; chosen, far longer than any adapter holds bytes."""

_COPIES = 4  # the last replies that may come a second time
_CHOICE = 40  # lengths to choose from; chosen: as many questions as a control loop asks in 0.2 s
_FEWEST = 8  # lengths to choose from even if time is short; chosen


class StaleReplies:
    """Keeps track of the replies of each servo that may still arrive.

    ``overdue`` has when each that did not come was asked for, by servo and length [s].
    """

    def __init__(self) -> None:
        self._start = 0  # of the last question
        self._question: tuple[Collection[int], int] = (), 0  # who was asked last, with what length
        self._t_asked = 0.0
        self._asked: dict[tuple[int, int], float] = {}  # who with what length, and when
        self._missing: dict[int, dict[int, float]] = {}  # until when, by servo and length
        self.overdue: dict[tuple[int, int], float] = {}
        self._copies: dict[int, deque[tuple[int, float]]] = {}  # lengths and until when, by servo
        self._until = -math.inf  # when the last of them will be over

    def span(
        self,
        servo_ids: Collection[int],
        start: int,
        count: int,
        now: float,
        *,
        again: bool = False,
        longest: Callable[[int], int] | None = None,
    ) -> tuple[int, int]:
        """Choose address and length of a question so that stale replies differ in length.

        If stale replies of every length may come, the length is chosen whose stale reply is due
        soonest. That takes many questions in a row without waiting for replies.

        With ``again`` an older reply to the same question would do no harm. ``longest`` returns the
        longest reply there is time for from so many servos [byte]; at least eight lengths are
        tried.
        """
        if not (again and start == self._start):
            self._expect_copies()
        length = count if now >= self._until else self._choose(servo_ids, count, now, longest)
        self._start, question = start, (servo_ids, length)
        if question != self._question:
            self._note()
            self._question = question
        self._t_asked = now
        return min(start, END - length), length

    def missed(self, servo_ids: Collection[int], length: int, asked: float) -> None:
        """Note that replies of this length are overdue; the question was sent at ``asked`` [s]."""
        self._until = max(self._until, asked + OVERDUE)
        for servo_id in servo_ids:
            self._missing.setdefault(servo_id, {})[length] = self._until
            self.overdue[servo_id, length] = asked

    def awaits(self, now: float) -> bool:
        if self.overdue and now >= self._until:
            self.overdue.clear()
        return bool(self.overdue)

    def came(self, servo_id: int, length: int, now: float) -> float | None:
        """Take note of a reply; return when it was asked for if it was overdue, else None [s]."""
        asked = self.overdue.pop((servo_id, length), None)
        return None if asked is None or now > asked + OVERDUE else asked

    def _note(self) -> None:
        servo_ids, length = self._question
        self._asked.update({(servo_id, length): self._t_asked for servo_id in servo_ids})

    def _choose(
        self,
        servo_ids: Collection[int],
        count: int,
        now: float,
        longest: Callable[[int], int] | None,
    ) -> int:
        taken: dict[int, float] = {}
        for servo_id in servo_ids:
            for length, until in (
                *self._copies.get(servo_id, ()),
                *self._missing.get(servo_id, {}).items(),
            ):
                if until > now:
                    taken[length] = max(until, taken.get(length, now))
        if count not in taken:
            return count
        most = END if longest is None else longest(len(servo_ids))
        end = min(count + _CHOICE, max(most + 1, count + _FEWEST), END)
        return min(range(count, max(end, count + 1)), key=lambda length: taken.get(length, now))

    def _expect_copies(self) -> None:
        self._note()
        self._question = (), 0
        for (servo_id, length), when in self._asked.items():
            copies = self._copies.setdefault(servo_id, deque(maxlen=_COPIES))
            self._until = max(self._until, when + OVERDUE)
            copies.append((length, self._until))
        self._asked.clear()
