"""Count each servo's good, lost and corrupt replies from the start of the program.

``Bus`` counts. Code that reopens the bus passes the same ``ReplyCounters`` to the new one, so that
the counts survive an unplugged cable and a new set-up. Any thread may read them.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class ReplyCounter:
    """Counts the replies of one servo.

    Attributes:
        answers: Right answers.
        lost: Questions without any answer.
        corrupt: Questions whose answer was garbled.
        retries: Questions asked again.
        faults: Its newest status byte, see ``Fault``.
        latched: Every status bit it has ever shown.
    """

    answers: int = 0
    lost: int = 0
    corrupt: int = 0
    retries: int = 0
    faults: int = 0
    latched: int = 0

    @property
    def asked(self) -> int:
        """How many questions there were, repeated ones included."""
        return self.answers + self.lost + self.corrupt

    def heard(self, faults: int) -> None:
        """Count a good reply with this status byte."""
        self.answers += 1
        self.faults = faults
        if faults:
            self.latched |= faults

    def missed(self, *, garbled: bool) -> None:
        """Count a missing or a garbled reply."""
        self.corrupt += garbled
        self.lost += not garbled


class ReplyCounters(dict[int, ReplyCounter]):
    """The counter of each servo, by id; made when the servo is first asked."""

    def __missing__(self, servo_id: int) -> ReplyCounter:
        """Make a new counter."""
        counter = self[servo_id] = ReplyCounter()
        return counter
