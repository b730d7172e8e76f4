"""How well servos are heard, counted one by one from the start of the program.

``Bus`` counts; whoever opens bus after bus on one port hands the ``Tallies`` on, so that neither an
unplugged cable nor a new set-up makes it forget. Any thread may read them.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Tally:
    """What happened with one servo since the start.

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
        """There was a right answer, with this status byte."""
        self.answers += 1
        self.faults = faults
        if faults:
            self.latched |= faults

    def missed(self, *, garbled: bool) -> None:
        """There was none, or one that could not be understood."""
        self.corrupt += garbled
        self.lost += not garbled


class Tallies(dict[int, Tally]):
    """The tally of each servo, by id; it begins when the servo is first asked."""

    def __missing__(self, servo_id: int) -> Tally:
        """A new tally."""
        tally = self[servo_id] = Tally()
        return tally
