"""Tell one lost reply from a servo that has fallen silent; word the errors about such servos."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from so101_motion.common.errors import NoReply, ServoFault
from so101_motion.common.state import ARM_JOINTS
from so101_motion.drivers.bus.bus import Bus

SILENT_AFTER = 0.25
"""A servo counts as silent after so long without an answer [s]. Chosen: meanwhile its joint moves
on unseen."""

ALL_SILENT_AFTER = 0.5
"""The same while no servo answers [s]. A busy computer was seen to hold back all answers for 0.3 s,
which is no reason to end a motion; without power, the other cause, nothing moves. Chosen."""

_FEWEST = 8
"""A servo counts as silent after at least so many reads. With 7 % of the answers spoiled, that
happens by chance once in 2e9 answers: twice a year for a resting arm, read every 50 ms. Chosen."""


class Presence:
    """Keeps track of which of ``servo_ids`` answer.

    ``silent`` are those that do not; it is replaced whole, so any thread may read it.
    """

    def __init__(self, servo_ids: Sequence[int]) -> None:
        self.silent: frozenset[int] = frozenset()
        self._ids = tuple(servo_ids)
        # Reads in a row without an answer and the time of the first, where there are any.
        self._misses: dict[int, tuple[int, float]] = {}

    @property
    def unanswering(self) -> Collection[int]:
        """The servos that did not answer last time: not worth waiting for in a cycle."""
        return self._misses.keys() | self.silent if self._misses or self.silent else ()

    @property
    def all_silent(self) -> bool:
        return len(self.silent) == len(self._ids)

    def judge(self, found: Collection[int], now: float) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Update from a read at ``now`` [s]; return who fell silent and who answers again."""
        if len(found) == len(self._ids) and not self._misses and not self.silent:
            return (), ()
        before, self._misses = self._misses, {}
        for servo_id in self._ids:
            if servo_id not in found:
                count, since = before.get(servo_id, (0, now))
                self._misses[servo_id] = (count + 1, since)
        enough = SILENT_AFTER if found else ALL_SILENT_AFTER
        lost = {
            servo_id
            for servo_id, (count, since) in self._misses.items()
            if count >= _FEWEST and now - since >= enough - 1e-9
        }
        fallen, back = tuple(sorted(lost - self.silent)), tuple(sorted(self.silent & set(found)))
        self.silent = (self.silent | lost) - set(back)
        return fallen, back

    def dismiss(self, servo_id: int) -> None:
        """Count a servo as silent that answered a read but could not be set up."""
        self.silent |= {servo_id}

    def restart(self, found: Collection[int]) -> None:
        """Start anew after connecting, with only ``found`` present."""
        self._misses = {}
        self.silent = frozenset(self._ids) - set(found)


def unconfirmed_position(bus: Bus, servo_id: int) -> NoReply:
    return NoReply(
        f"the position of {bus.label(servo_id)} is not clear: no two of its answers"
        " agree; nothing was switched on. Keep the joint still, check the plugs of its cable, then"
        " try again",
        servo_id=servo_id,
        register="present_position",
    )


def restarted_servos(bus: Bus, restarted: Sequence[int]) -> ServoFault:
    names = ", ".join(bus.label(servo_id) for servo_id in restarted)
    names = "all servos" if len(restarted) > len(ARM_JOINTS) else names
    one = len(restarted) == 1
    holds, its = ("holds where it is", "its") if one else ("hold where they are", "their")
    return ServoFault(
        f"{names} restarted and {holds} now; {its} power probably failed: check {its} cable and the"
        " supply",
        servo_id=restarted[0],
    )


def missing_servos(
    bus: Bus, missing: Sequence[int], others: Collection[int], doubted: Collection[int] = ()
) -> NoReply:
    """The error for servos that do not answer while ``others`` do; it says which cable to check.

    Servos that are ``doubted`` answer, but with an impossible position.
    """
    first = missing[0]
    if first in doubted:
        return NoReply(
            f"{bus.label(first)} reports positions that its joint cannot have reached;"
            " check the plugs of its cable, switch its power off and on, and if that does not help"
            " replace the servo",
            servo_id=first,
            register="present_position",
        )
    if not others:
        message = (
            f"{bus.port.name} is there but no servo answers; check that the arm's power supply is"
            " on and that the first cable is plugged into the adapter"
        )
    elif max(missing) < min(others) and (beyond := _answer_beyond(bus, missing, others)):
        message = (
            f"the ids run from {min(others)} to {beyond}, not from {first} to {max(others)}, so"
            " each servo has the id of another joint. Run so101 setup --start-over, then so101"
            " calibrate"
        )
    else:
        names = ", ".join(bus.label(servo_id) for servo_id in missing)
        if first - 1 in others and not any(servo_id > first for servo_id in others):
            where = f"the cable between servos {first - 1} and {first}"
        else:
            where = "its cable and that it has the right id"
        message = (
            f"no reply from {names} on {bus.port.name}; the others answer, and a silent servo may"
            f" hold nothing. Support the arm, and check {where}"
        )
    return NoReply(message, servo_id=first, register="present_position")


def _answer_beyond(bus: Bus, missing: Sequence[int], others: Collection[int]) -> int:
    """The last of as many servos after the others as are missing before them; 0 if not all are."""
    beyond = [max(others) + k for k in range(1, len(missing) + 1)]
    return beyond[-1] if bus.answering(beyond, tries=1) == beyond else 0
