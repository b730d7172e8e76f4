"""Find servos whose id and baud rate are not known.

A ping to all finds every id at once, but only servos that listen at the port's rate hear it. So the
port is tuned through the eight rates a servo can have, the likeliest first. Each rate takes as long
as 254 answers would, 23 ms at the fastest and 0.6 s at the slowest; all eight take 1.9 s.

A rate at which a servo answers is asked a second time, because no servo may be missed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Self, TypeVar

from so101_motion.calib.access import BusAccess
from so101_motion.common.errors import PortUnavailable
from so101_motion.drivers.bus.bus import Bus

T = TypeVar("T")

LIKELIEST_FIRST = (1_000_000, 500_000, 115_200, 57_600, 38_400, 250_000, 128_000, 76_800)
"""Every rate of ``BAUDS``. Servos come with the first; the next are what other programs and other
brands use. Chosen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RateAnswers:
    """The servos that answer at one rate."""

    baud: int  # the rate [bit/s]
    ids: tuple[int, ...]  # ids of those that answer
    garbled: bool  # whether there were corrupt replies

    @property
    def is_silence(self) -> bool:
        return not self.ids and not self.garbled


class Tuner:
    """Tunes a lent bus to any rate; the end of a ``with`` block restores the port's own.

    Attributes:
        home: The port's own rate [bit/s].
    """

    def __init__(self, access: BusAccess) -> None:
        self._access = access
        self.home = self.baud = access.call(lambda bus: bus.port.baud)

    def tune(self, baud: int) -> None:
        if baud != self.baud:
            self._access.at_baud(baud)
            self.baud = baud

    def call(self, job: Callable[[Bus], T]) -> T:
        return self._access.call(job)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if error is None:
            self.tune(self.home)
            return
        with contextlib.suppress(PortUnavailable):  # the first error counts
            self.tune(self.home)


def listen(tuner: Tuner) -> RateAnswers:
    """Find the servos at the present rate; asks each that answers a second time."""
    roll = tuner.call(Bus.ping_all)
    if not roll.ids and not roll.garbled:
        return RateAnswers(baud=tuner.baud, ids=(), garbled=False)
    again = tuner.call(Bus.ping_all)
    return RateAnswers(
        baud=tuner.baud,
        ids=tuple(sorted({*roll.ids, *again.ids})),
        garbled=roll.garbled and again.garbled,
    )


def find_first_rate(
    tuner: Tuner, *, hint: int | None = None, on_rate: Callable[[int], None] = lambda baud: None
) -> RateAnswers | None:
    """The first rate at which a servo answers, from ``hint`` on; the tuner stays there."""
    rates = dict.fromkeys((hint or tuner.home, tuner.home, *LIKELIEST_FIRST))
    # The likeliest in between: a servo that was plugged in just now takes a moment to start, and a
    # single answer may have been lost.
    order = [rate for baud in rates for rate in (baud, tuner.home)]
    for heard in sweep(tuner, order, on_rate):
        if not heard.is_silence:
            return heard
    return None


def find_all_rates(
    tuner: Tuner, *, on_rate: Callable[[int], None] = lambda baud: None
) -> list[RateAnswers]:
    rates = dict.fromkeys((tuner.home, *LIKELIEST_FIRST))
    return [heard for heard in sweep(tuner, rates, on_rate) if not heard.is_silence]


def sweep(
    tuner: Tuner, rates: Iterable[int], on_rate: Callable[[int], None] = lambda baud: None
) -> Iterator[RateAnswers]:
    """Listen at each of ``rates`` [bit/s] in turn, as long as the caller goes on."""
    for baud in rates:
        on_rate(baud)
        tuner.tune(baud)
        yield listen(tuner)
