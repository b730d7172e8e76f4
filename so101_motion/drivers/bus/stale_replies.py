"""Tell the reply to a question from late replies to earlier questions.

An answer names its servo, but neither the question nor the register. All that a question leaves on
it is its length: a servo can be asked for more bytes than are needed, and the answer has exactly as
many as were asked for. So as long as an answer is overdue, the next question to that servo uses
another length, and the straggler is skipped when it comes. Some adapters also deliver an answer
twice; so when a question means something else than the one before, copies of the last answers are
reckoned with as well. (A control cycle asks for the same over and over. There a copy would merely
be old.)
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection

from so101_motion.drivers.bus.registers import END

OVERDUE = 0.25
"""For how long an answer that did not come is still reckoned with [s]; chosen, far above what any
adapter holds back."""

_COPIES = 4  # of how many answers a copy is reckoned with
_CHOICE = 40  # lengths to choose from; chosen: as many questions as a control loop asks in 0.2 s
_FEWEST = 8  # and so many always, however little time there is; chosen


class StaleReplies:
    """Keeps track of the replies of each servo that may still arrive."""

    def __init__(self) -> None:
        self._start = 0  # of the last question
        self._asked: dict[tuple[int, int], float] = {}  # who with what length, and when
        self._missing: dict[int, dict[int, float]] = {}  # until when, by servo and length
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
        most: int = END,
    ) -> tuple[int, int]:
        """Choose address and length of a question so that stale replies differ in length.

        If all lengths are taken, it is the one whose straggler is due soonest; that many stragglers
        need a stream of questions that nobody waits for.

        Args:
            servo_ids: Whom.
            start: The first address that is needed.
            count: How many bytes are.
            now: The time [s].
            again: Whether an older answer to the same question would do no harm.
            most: More bytes than this would take too long; at least eight lengths are tried.

        Returns:
            The first address and the number of bytes; what is needed is among them.
        """
        if not (again and start == self._start):
            self._expect_copies()
        length = self._choose(servo_ids, count, now, most)
        self._start = start
        self._asked.update({(servo_id, length): now for servo_id in servo_ids})
        return min(start, END - length), length

    def missed(self, servo_id: int, length: int, now: float) -> None:
        """Note at ``now`` [s] that a reply of this length is overdue."""
        self._until = max(self._until, now + OVERDUE)
        self._missing.setdefault(servo_id, {})[length] = self._until

    def _choose(self, servo_ids: Collection[int], count: int, now: float, most: int) -> int:
        if now >= self._until:
            return count
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
        end = min(count + _CHOICE, max(most + 1, count + _FEWEST), END)
        return min(range(count, max(end, count + 1)), key=lambda length: taken.get(length, now))

    def _expect_copies(self) -> None:
        """The coming answers mean something else than those before."""
        for (servo_id, length), when in self._asked.items():
            copies = self._copies.setdefault(servo_id, deque(maxlen=_COPIES))
            self._until = max(self._until, when + OVERDUE)
            copies.append((length, self._until))
        self._asked.clear()
