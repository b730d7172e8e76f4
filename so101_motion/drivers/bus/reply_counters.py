"""Count each servo's good, late, lost and corrupt replies from the start of the program.

Code that reopens the bus passes the same ``ReplyCounters`` on. Any thread may read them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

_DELAYS = 64  # chosen: ten control cycles
_TYPICAL = 0.55  # chosen: an adapter that hands over two answers at once makes half of them late


@dataclass(slots=True)
class ReplyCounter:
    """Counts the replies of one servo."""

    answers: int = 0  # right answers
    late: int = 0  # questions whose answer came after its timeout, and could not be used
    lost: int = 0  # questions without any answer
    corrupt: int = 0  # questions whose answer was garbled
    retries: int = 0  # questions asked again
    faults: int = 0  # its newest status byte, see ``Fault``
    latched: int = 0  # every status bit it has ever shown

    @property
    def asked(self) -> int:
        """How many questions there were, repeated ones included."""
        return self.answers + self.late + self.lost + self.corrupt

    def heard(self, faults: int) -> None:
        self.answers += 1
        self.faults = faults
        if faults:
            self.latched |= faults

    def missed(self, *, garbled: bool) -> None:
        self.corrupt += garbled
        self.lost += not garbled

    def came_late(self) -> None:
        """Count a reply as late that was counted as missing."""
        self.late += 1
        if self.lost:
            self.lost -= 1
        else:  # something else was heard in its place
            self.corrupt -= 1


class Lateness:
    """How much later the last 64 answers came than the wire explains.

    Attributes:
        longest: The longest delay [s].
    """

    def __init__(self) -> None:
        self.longest = 0.0
        self._delays: deque[float] = deque(maxlen=_DELAYS)
        self._typical: float | None = 0.0  # None until somebody asks

    @property
    def typical(self) -> float:
        """55 % of them came no later [s]."""
        if self._typical is None:
            self._typical = sorted(self._delays)[int(_TYPICAL * len(self._delays))]
        return self._typical

    def measured(self, delay: float, answers: int) -> None:
        """Note that so many answers came ``delay`` [s] late."""
        self._delays.extend([max(delay, 0.0)] * answers)
        self.longest, self._typical = max(self._delays), None


class ReplyCounters(dict[int, ReplyCounter]):
    """The counter of each servo, by id, made when it is first asked; and how late answers come."""

    def __init__(self) -> None:
        super().__init__()
        self.lateness = Lateness()

    def __missing__(self, servo_id: int) -> ReplyCounter:
        counter = self[servo_id] = ReplyCounter()
        return counter

    def all_heard(self, servo_ids: Iterable[int]) -> None:
        """Count an answer without a fault of each."""
        for servo_id in servo_ids:
            counter = self[servo_id]
            counter.answers += 1
            counter.faults = 0
