"""Check the configurations of an episode for contact with the arm itself, the table and a scene.

Every frame is checked, but not the motion between two frames. The bodies are the hulls that
planning uses, and touching means nearer than ``TOUCH`` instead of planning's margin: a recording of
a hand-guided arm may pass close by.
"""

from __future__ import annotations

import heapq
import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.units import to_mm
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.datasets.data_set import Episode
from so101_motion.tasks.datasets.moments import (
    CONTACT,
    MOST,
    Moment,
    Moments,
    runs,
)

TOUCH = 0.0005
"""Bodies nearer than this touch [m]; the hulls are less than 1 mm outside of the parts."""

_DEEP = 0.002  # [m]; the limit that the depth of a contact is compared with. Chosen
_LOOKS = 5  # frames of a contact in which its depth is measured


class _Stretch(NamedTuple):
    """Frames of an episode in contact; the longer counts as the worse until depths are known."""

    frames: int
    order: int
    episode: int
    of: str
    first: int
    looks: tuple[int, ...]
    q: Array


class ContactCheck:
    """Checks episodes one after the other. Belongs to one thread.

    Measuring the depth of a contact takes long, so it is done at the end, for the longest ones.

    Args:
        moments: Collects the contacts.
        fps: Frames a second.
        scene: What is around the arm; None for just the table.
    """

    def __init__(self, moments: Moments, *, fps: float, scene: Scene | None = None) -> None:
        self._moments, self._fps = moments, fps
        scene = replace(scene or Scene(), margin=TOUCH)
        self._collision = CollisionModel(RobotModel.load(), scene)
        self._longest: list[_Stretch] = []
        self._order = itertools.count()

    def check(self, episode: Episode, of: str, q: Array) -> None:
        """Check the angles of an episode, shape (n, 6), [rad]; frames with NaN are left out."""
        known = np.isfinite(q).all(axis=1)
        touching = np.zeros(len(q), dtype=bool)
        touching[known] = self._collision.touching(q[known, :5], q[known, 5])
        for first, last in runs(touching):
            frames = last - first + 1
            if len(self._longest) >= MOST and frames <= self._longest[0].frames:
                self._moments.count(CONTACT, 1, frames)
                continue
            looks = tuple(sorted(set(np.linspace(first, last, _LOOKS).astype(int).tolist())))
            found = _Stretch(
                frames, -next(self._order), episode.index, of, first, looks, q[list(looks)]
            )
            heapq.heappush(self._longest, found)
            if len(self._longest) > MOST:
                self._moments.count(CONTACT, 1, heapq.heappop(self._longest).frames)

    def finish(self) -> None:
        """Measure how deep the longest contacts are, and add them to the moments."""
        for each in sorted(self._longest, key=lambda each: each.order, reverse=True):
            seconds = each.frames / self._fps
            clearances = [self._collision.clearance(q[:5], float(q[5])) for q in each.q]
            k = int(np.argmin([found.distance for found in clearances]))
            found, frame = clearances[k], each.looks[k]
            self._moments.add(
                Moment(
                    kind=CONTACT,
                    episode=each.episode,
                    frame=frame,
                    t=frame / self._fps,
                    first=each.first,
                    last=each.first + each.frames - 1,
                    of=each.of,
                    what=f"{found.first}, {found.second}",
                    value=to_mm(max(-found.distance, 0.0)),
                    limit=to_mm(_DEEP),
                    unit="mm",
                    sentence=f"{each.of}: {found.message('is')}, for {seconds:.1f} s",
                )
            )
        self._longest.clear()
