"""Which servos are there: telling a lost answer from a servo that has fallen silent."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from so101_motion.drivers.bus import Bus
from so101_motion.errors import NoReply

SILENT_AFTER = 5
"""So many reads in a row without an answer, each with one repetition, make a servo silent. Chosen:
with 7 % of the answers spoiled that happens by chance once in 3e11 reads."""


@dataclass(frozen=True, slots=True)
class Change:
    """What one read has changed.

    Attributes:
        fallen: Servos that are silent from now on.
        back: Servos that are not any more.
    """

    fallen: tuple[int, ...]
    back: tuple[int, ...]


_NO_CHANGE = Change((), ())


class Presence:
    """Keeps track of who answers.

    Args:
        servo_ids: Who should.

    Attributes:
        silent: Who does not; replaced whole, so any thread may look.
    """

    def __init__(self, servo_ids: Sequence[int]) -> None:
        self.silent: frozenset[int] = frozenset()
        self._ids = tuple(servo_ids)
        self._misses: dict[int, int] = {}  # reads in a row without an answer, where there are any

    @property
    def all_silent(self) -> bool:
        """Whether nobody answers."""
        return len(self.silent) == len(self._ids)

    def judge(self, found: Collection[int]) -> Change:
        """Take in who answered a read."""
        if len(found) == len(self._ids) and not self._misses and not self.silent:
            return _NO_CHANGE
        self._misses = {i: self._misses.get(i, 0) + 1 for i in self._ids if i not in found}
        lost = {servo_id for servo_id, misses in self._misses.items() if misses >= SILENT_AFTER}
        change = Change(
            fallen=tuple(sorted(lost - self.silent)), back=tuple(sorted(self.silent & set(found)))
        )
        self.silent = (self.silent | lost) - set(change.back)
        return change

    def dismiss(self, servo_id: int) -> None:
        """Take a servo for silent that has just answered but cannot be talked to."""
        self.silent |= {servo_id}

    def restart(self, found: Collection[int]) -> None:
        """After connecting: only ``found`` are there."""
        self._misses = {}
        self.silent = frozenset(self._ids) - set(found)


def not_there(bus: Bus, missing: Sequence[int], others: Collection[int]) -> NoReply:
    """What to tell somebody under the table about servos that do not answer.

    Args:
        bus: Where they are missed.
        missing: Who does not answer, in order.
        others: Who does.
    """
    first = missing[0]
    if not others:
        message = (
            f"{bus.port.name} is there but no servo answers; check that the arm's power supply is"
            " on and that the first cable is plugged into the adapter"
        )
    else:
        names = ", ".join(bus.label(servo_id) for servo_id in missing)
        if first - 1 in others and not any(servo_id > first for servo_id in others):
            where = f"the cable between servos {first - 1} and {first}"
        else:
            where = "its cable and that it has the right id"
        message = f"no reply from {names}; the others answer. Check {where}"
    return NoReply(message, servo_id=first, register="present_position")
