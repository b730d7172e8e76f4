"""Collect the moments of a data set at which something is wrong, and rank them."""

from __future__ import annotations

import heapq
import itertools
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MISSING, TIME, JUMP, CONTACT = "missing", "time", "jump", "contact"
LIMIT, FROZEN, SPEED, TRACKING = "limit", "frozen", "speed", "not reached"

KINDS = {
    JUMP: "a joint is sent, or seems to go, faster than any servo can",
    CONTACT: "the arm touches itself, the table or the scene",
    MISSING: "numbers are missing or cannot be angles",
    FROZEN: "a joint stands while its action moves on: it is blocked, or was not read",
    LIMIT: "a joint is beyond its travel",
    TRACKING: "a joint is far from where it was sent",
    TIME: "frames are missing or out of order",
    SPEED: "a joint is faster than the cap",
}
"""The kinds of moments, the most serious first."""

_WEIGHT = {kind: 2.0 ** (len(KINDS) - place) for place, kind in enumerate(KINDS)}
_HALF = 5.0  # so many times the limit gives half of the largest severity; chosen
MOST = 200  # how many moments of a kind are kept; the others are counted. Chosen.
MOST_OF_EPISODE = 50  # of a kind and an episode get a sentence; the others are counted. Chosen.


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """Something wrong, from one frame to another."""

    kind: str  # one of ``KINDS``
    episode: int
    frame: int  # the worst frame, counted from 0 in the episode
    t: float  # when that is, from the beginning of the episode [s]
    first: int
    last: int
    of: str  # ``"action"`` or ``"state"``, or empty for both
    what: str  # the joint, or what is in contact; empty for the whole frame
    value: float  # how bad it is there, in ``unit``
    limit: float  # the largest value that is allowed
    unit: str  # such as ``"deg"``
    sentence: str  # all of it in one sentence

    @property
    def severity(self) -> float:
        """How bad it is: larger is worse; kinds differ in weight."""
        ratio = abs(self.value) / self.limit
        return _WEIGHT[self.kind] * (1.0 + ratio / (ratio + _HALF))

    def to_json(self) -> dict[str, object]:
        names = ("kind", "episode", "frame", "first", "last", "of", "what", "unit", "sentence")
        return {
            **{name: getattr(self, name) for name in names},
            "time_s": round(self.t, 4),
            "value": round(self.value, 4),
            "limit": round(self.limit, 4),
        }


class About(NamedTuple):
    """The fields of ``Moment`` that all moments of one check share."""

    kind: str
    of: str
    what: str
    limit: float
    unit: str


class Moments:
    """Collects moments and keeps the worst of each kind."""

    def __init__(self, fps: float) -> None:
        self._fps = fps
        self.counts: Counter[str] = Counter()
        self.frames: Counter[str] = Counter()
        self._kept: dict[str, list[tuple[float, int, Moment]]] = {}
        self._order = itertools.count()

    def add(
        self,
        about: About,
        episode: int,
        first: int,
        last: int,
        frame: int,
        value: float,
        sentence: str,
    ) -> None:
        """Count a moment, and keep it if it is one of the worst; arguments as in ``Moment``."""
        moment = Moment(
            **about._asdict(),
            episode=episode,
            frame=frame,
            t=frame / self._fps,
            first=first,
            last=last,
            value=value,
            sentence=sentence,
        )
        self.count(moment.kind, 1, moment.last - moment.first + 1)
        kept = self._kept.setdefault(moment.kind, [])
        entry = (moment.severity, -next(self._order), moment)  # of equals, the first is kept
        if len(kept) < MOST:
            heapq.heappush(kept, entry)
        else:
            heapq.heappushpop(kept, entry)

    def count(self, kind: str, moments: int, frames: int) -> None:
        self.counts[kind] += moments
        self.frames[kind] += frames

    def worst(self) -> tuple[Moment, ...]:
        """Those that are kept, the worst first."""
        kept = itertools.chain.from_iterable(self._kept.values())
        return tuple(moment for *_, moment in sorted(kept, key=lambda e: (-e[0], -e[1])))


def runs(mask: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """The stretches over which ``mask``, shape (n,), is true, as first and last index."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    yield from zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True)
