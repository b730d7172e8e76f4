"""What plans depend on besides the arms' positions, and so does what is said of them."""

from __future__ import annotations

from collections.abc import Iterable

from so101_motion.arm.arm import Arm
from so101_motion.common.modes import Mode

from . import texts


def things_around(arm: Arm) -> tuple[object, ...]:
    """What an arm's plans depend on besides its position."""
    return (arm.scene, arm.range, arm.speed, arm.acceleration)


def same_things(things: tuple[object, ...], others: tuple[object, ...]) -> bool:
    """Whether scenes and ranges are identical objects, and figures equal."""
    return len(things) == len(others) and all(
        one is other or (isinstance(one, float) and one == other)
        for one, other in zip(things, others, strict=True)
    )


class Causes:
    """Tells whether the cause of a red sentence may be gone."""

    def __init__(self, arms: Iterable[Arm]) -> None:
        self._arms = tuple(arms)
        self._seen = self._now()

    def have_changed(self) -> bool:
        """Whether limits, surroundings or what an arm can do changed since the last call."""
        before, self._seen = self._seen, self._now()
        return not same_things(before, self._seen)

    def _now(self) -> tuple[object, ...]:
        things = (each for arm in self._arms for each in things_around(arm))
        return (*things, *(texts.blocked(arm.state) is None for arm in self._arms))


class NextEvent:
    """Tells whether Stop was pressed or a motion began, whoever did it."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._seen = arm.stops, arm.state.mode

    def look(self) -> tuple[bool, bool]:
        """Whether the arm was told to stop, and whether a motion began, since the last call."""
        (stops, mode), self._seen = self._seen, (self._arm.stops, self._arm.state.mode)
        return stops != self._seen[0], mode is not self._seen[1] is Mode.MOVING
