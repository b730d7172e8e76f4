"""Check a whole data set: read it once to see what its numbers mean, once more to check them.

Contact is looked for in every frame, not between two. Bodies are planning's hulls, without its
margin: a recording of a hand-guided arm may pass close by.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from so101_motion.calib.record.store import Stored
from so101_motion.common.errors import ConfigError, quoted
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_mm
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.datasets.data_set import ACTION, STATE, DataSet, Episode
from so101_motion.tasks.datasets.joint_checks import SPEED_CAP, Differences, JointCheck, Tracking
from so101_motion.tasks.datasets.metadata import EPISODES_3, UNITS
from so101_motion.tasks.datasets.moments import (
    CONTACT,
    KINDS,
    MOST,
    TIME,
    About,
    Moment,
    Moments,
    runs,
)
from so101_motion.tasks.datasets.parquet import Reader
from so101_motion.tasks.datasets.units import (
    CERTAIN,
    IN_WORDS,
    JAW_CLOSED,
    LIKELY,
    UNKNOWN,
    Fit,
    Units,
    UnitsGuess,
    Verdict,
    units_of,
)

TOUCH = 0.0005  # bodies nearer than this touch [m]; hulls are less than 1 mm outside of the parts
_DEEP = 0.002  # [m]; the limit that the depth of a contact is compared with. Chosen
_LOOKS = 5  # frames of a contact in which its depth is measured


class _Stretch(NamedTuple):
    """Frames of an episode in contact; the longer counts as the worse until depths are known."""

    frames: int
    episode: int
    of: str
    first: int
    looks: tuple[int, ...]
    q: Array


class ContactCheck:
    """Checks episodes one after the other for contact. Belongs to one thread.

    Measuring the depth of a contact takes long, so it is done at the end, for the longest ones.
    Without a scene there is just the table.
    """

    def __init__(self, moments: Moments, *, fps: float, scene: Scene | None = None) -> None:
        self._moments, self._fps = moments, fps
        scene = replace(scene or Scene(), margin=TOUCH)
        self._collision = CollisionModel(RobotModel.load(), scene)
        self._longest: list[_Stretch] = []

    def check(self, episode: Episode, of: str, q: Array) -> None:
        """Check the angles of an episode, shape (n, 6), [rad]; frames with NaN are left out."""
        known = np.isfinite(q).all(axis=1)
        touching = np.zeros(len(q), dtype=bool)
        touching[known] = self._collision.touching(q[known, :5], q[known, 5])
        for first, last in runs(touching):
            looks = tuple(sorted(set(np.linspace(first, last, _LOOKS).astype(int).tolist())))
            found = _Stretch(last - first + 1, episode.index, of, first, looks, q[list(looks)])
            self._longest.append(found)
        self._longest.sort(key=lambda each: -each.frames)
        for each in self._longest[MOST:]:
            self._moments.count(CONTACT, 1, each.frames)
        del self._longest[MOST:]

    def finish(self) -> None:
        """Measure how deep the longest contacts are, and add them to the moments."""
        for each in self._longest:
            clearances = [self._collision.clearance(q[:5], float(q[5])) for q in each.q]
            k = int(np.argmin([found.distance for found in clearances]))
            found, last = clearances[k], each.first + each.frames - 1
            self._moments.add(
                About(CONTACT, each.of, f"{found.first}, {found.second}", to_mm(_DEEP), "mm"),
                each.episode, each.first, last, each.looks[k], to_mm(max(-found.distance, 0.0)),
                f"{each.of}: {found.message('is')}, for {each.frames / self._fps:.1f} s",
            )  # fmt: skip
        self._longest.clear()


_MOSTLY_OUTSIDE = 0.05  # share of frames beyond the stops at which units are doubted. Chosen.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheckReport:
    """The result of a check."""

    data_set: DataSet
    units: Units  # the units that its numbers were taken to have
    why_units: str  # the reason for them, as text
    certainty: str  # how certain they are, as in ``units.Verdict``
    fits: tuple[Fit, ...]  # how well each of the possible units fits
    notes: tuple[str, ...]  # notes for the user, to be read first
    lengths: Mapping[int, int]  # how many frames each episode has, by its number, in order
    moments: tuple[Moment, ...]  # the worst moments, the worst first
    counts: Mapping[str, int]  # how many moments of each kind there were, kept or not
    frames_of: Mapping[str, int]  # how many frames those had in total, by kind
    differences: Differences | None  # states from actions; None if not known

    @property
    def episodes(self) -> int:
        return len(self.lengths)

    @property
    def frames(self) -> int:
        return sum(self.lengths.values())

    @property
    def headlines(self) -> tuple[str, str]:
        """What the data set is, and its units, as text."""
        metadata = self.data_set.metadata
        return (
            f"LeRobot {metadata.version}, {metadata.robot or 'no robot named'}:"
            f" {self.episodes} episode{'s' * (self.episodes != 1)}, {self.frames} frames"
            f" at {metadata.fps:g} a second"
            f" ({self.frames / metadata.fps / 60.0:.1f} min)",
            f"units: {IN_WORDS[self.units.kind]} ({self.certainty}: {self.why_units})",
        )

    def to_json(self) -> dict[str, object]:
        metadata = self.data_set.metadata
        return {
            "path": str(metadata.root),
            "codebase_version": metadata.version,
            "robot": metadata.robot,
            "fps": metadata.fps,
            "episodes": self.episodes,
            "frames": self.frames,
            "units": self.units.kind,
            "why_units": self.why_units,
            "units_are": self.certainty,
            "zeros": dict(zip(ARM_JOINTS, self.units.zeros, strict=True)),
            "outside_stops": {fit.kind: round(fit.outside, 4) for fit in self.fits},
            "notes": list(self.notes),
            "counts": {kind: self.counts.get(kind, 0) for kind in KINDS},
            "differences": None if self.differences is None else asdict(self.differences),
            "moments": [moment.to_json() for moment in self.moments],
        }


def check_data_set(
    data_set: DataSet,
    *,
    units: str = "",
    calibration: Stored | None = None,
    scene: Scene | None = None,
    speed: float = SPEED_CAP,
) -> CheckReport:
    """Check a data set; reads each episode twice and holds one at a time.

    Args:
        data_set: The data set.
        units: The units of its numbers, one of ``units.KINDS``; found out if empty.
        calibration: Of the arm that was recorded; None if it is not known.
        scene: What was around the arm; None for just the table.
        speed: A faster joint is reported [rad/s].

    Raises:
        ConfigError: A file is broken, or there are no such units.
    """
    verdict, guess, doubts = meaning(data_set, units, calibration)
    meant, is_known = units_of(verdict.kind, calibration), verdict.certainty != UNKNOWN
    fps = data_set.metadata.fps
    moments = Moments(fps)
    anywhere = np.full(5, np.inf)
    joints = JointCheck(
        moments,
        fps=fps,
        lower=meant.lower[:5] if is_known else -anywhere,
        upper=meant.upper[:5] if is_known else anywhere,
        has_jaw=data_set.has_jaw,
        speed=speed,
    )
    if data_set.metadata.is_mobile:
        scene = replace(scene or Scene(), floor_z=None)
    contact = ContactCheck(moments, fps=fps, scene=scene)
    lengths: dict[int, int] = {}
    tracked: list[Tracking] = []
    for episode in data_set.episodes():
        lengths[episode.index] = len(episode)
        action, state = angles(data_set, meant, episode)
        found = joints.check(episode, action, state)
        tracked += [] if found is None else [found]
        if is_known:
            contact.check(episode, "action", action)
        if is_known and state is not None:
            contact.check(episode, "state", state)
    contact.finish()
    _add_missing_episodes(data_set, lengths, moments)
    return CheckReport(
        data_set=data_set,
        units=meant,
        why_units=verdict.why,
        certainty=verdict.certainty,
        fits=guess.fits(),
        notes=(*doubts, *_notes(data_set, verdict, guess.fits(), calibration, lengths)),
        lengths=lengths,
        moments=moments.worst(),
        counts=dict(moments.counts),
        frames_of=dict(moments.frames),
        differences=Differences.of(tracked, fps) if tracked else None,
    )


def _add_missing_episodes(data_set: DataSet, lengths: Mapping[int, int], moments: Moments) -> None:
    """Add a moment for each gap in the episodes' numbers, at the end of the episode before it."""
    there = sorted(lengths)
    most = max([*data_set.announced(), (data_set.metadata.episodes or 0) - 1], default=-1)
    for before, after in pairwise((-1, *there, max(most, *there, -1) + 1)):
        if after - before < 2 or not there:
            continue
        at = max(before, there[0])
        frame = 0 if before < 0 else lengths[at] - 1
        named = (
            f"episode {before + 1} is"
            if after - before == 2
            else (f"episodes {before + 1} to {after - 1} are")
        )
        moments.add(
            About(TIME, "", "", 1.0, "episodes"), at, frame, frame, frame, after - before - 1.0,
            f"{named} missing",
        )  # fmt: skip


def meaning(
    data_set: DataSet, units: str, calibration: Stored | None
) -> tuple[Verdict, UnitsGuess, tuple[str, ...]]:
    """Find the units of a data set, how its numbers fit all of them, and what makes them doubtful.

    Reads all of it. Without ``units`` they are found out; ``ConfigError`` if the numbers fit none,
    or there are no such units. The calibration is that of the arm that was recorded, if it is
    known.
    """
    if units:
        units_of(units, calibration)
    by_column = {name: UnitsGuess(calibration) for name in data_set.columns}
    for episode in data_set.episodes():
        by_column[ACTION].add(episode.action)
        if episode.state is not None:
            by_column[STATE].add(episode.state)
    guess = by_column.get(STATE, by_column[ACTION])
    doubts = tuple(f"{name}: {doubt}" for name, it in by_column.items() for doubt in it.doubts())
    metadata = data_set.metadata
    if units:
        verdict = Verdict(kind=units, certainty=CERTAIN, why="as asked for")
    elif data_set.declared:
        why = f"declared in {UNITS}"
        verdict = Verdict(kind=data_set.declared, certainty=CERTAIN, why=why)
    elif any(each.too_small for each in by_column.values()):
        reason = f"{doubts[0]}; convert them first, or give the units if it is none of these"
        raise ConfigError("units", None, reason)
    else:
        verdict = guess.best(metadata.robot, metadata.version, metadata.features[ACTION].names)
    return verdict, guess, doubts


def angles(data_set: DataSet, units: Units, episode: Episode) -> tuple[Array, Array | None]:
    """Convert action and state of an episode to angles of the model [rad], shapes (n, 6).

    A jaw that was not recorded is taken to be closed.
    """

    def in_model(x: Array) -> Array:
        q = units.to_model(x)
        if not data_set.has_jaw:
            q[:, 5] = JAW_CLOSED
        return q

    return in_model(episode.action), None if episode.state is None else in_model(episode.state)


def _notes(
    data_set: DataSet,
    units: Verdict,
    fits: Sequence[Fit],
    calibration: Stored | None,
    lengths: Mapping[int, int],
) -> tuple[str, ...]:
    metadata, notes = data_set.metadata, list[str]()
    episodes, frames = len(lengths), sum(lengths.values())
    if data_set.declared not in ("", units.kind):
        notes.append(
            f"{UNITS} declares {data_set.declared}, which contradicts --units {units.kind}"
        )
    if units.certainty == UNKNOWN:
        notes.append(
            "the evidence for its units is not enough, so limits and contacts were not checked;"
            " give --units"
        )
    elif units.certainty == LIKELY:
        notes.append("the units are likely, not certain; if they are others, give --units")
    if metadata.is_mobile:
        notes.append(
            f"{metadata.robot} carries its arm on a base, so contact with a table was not checked"
        )
    notes += _not_loaded(data_set)
    here = next(fit for fit in fits if fit.kind == units.kind)
    if here.outside > _MOSTLY_OUTSIDE:
        better = min(fits, key=lambda fit: fit.outside)
        note = (
            f"in {100.0 * here.outside:.0f} % of the frames a joint would be beyond its stops, by"
            f" up to {here.worst_deg:.0f} deg, so these are hardly {IN_WORDS[units.kind]}"
        )
        if better.outside < here.outside / 2.0:
            note += f"; {IN_WORDS[better.kind]} would fit (--units {better.kind})"
        notes.append(note)
    if units.kind == "old":
        notes.append(
            "its zeros are from before June 2025: a newer LeRobot would replay it wrongly;"
            " so101 dataset convert turns it into new units"
        )
    if calibration is None and units.kind in ("degrees", "range"):
        notes.append(
            "the arm's calibration is not known (give it with --calibration), so every joint is"
            " assumed to have been calibrated from stop to stop; angles may be off by some degrees,"
            " and contacts by some centimetres"
        )
    if metadata.episodes not in (None, episodes):
        notes.append(f"info.json says {metadata.episodes} episodes; there are {episodes}")
    if metadata.frames not in (None, frames):
        notes.append(f"info.json says {metadata.frames} frames; there are {frames}")
    return tuple(notes)


def _not_loaded(data_set: DataSet) -> list[str]:
    """Why LeRobot itself does not load the data set, as notes."""
    metadata, notes = data_set.metadata, list[str]()
    if pointers := metadata.lfs_pointers():
        notes.append(
            f"{len(pointers)} files are Git LFS pointers, {pointers[0].relative_to(metadata.root)}"
            " for one: their data was not downloaded; run git lfs pull"
        )
    filmed = {part for path in metadata.root.glob("videos/**/*.mp4") for part in path.parts}
    notes += [
        f"there are no videos of {quoted(name)}"
        for name, feature in metadata.features.items()
        if feature.dtype == "video" and name not in filmed
    ]
    if not metadata.is_v3:
        return [
            *notes,
            f"LeRobot since 0.4 loads version {metadata.version} only after its own conversion to"
            " version 3.0",
        ]
    if not any((metadata.root / EPISODES_3).glob("*/*.parquet")):
        notes.append(f"LeRobot itself cannot load it: {EPISODES_3} is missing")
    first: dict[str, str] = {}
    for path in metadata.data_files():
        with Reader(path) as file:
            first = first or file.types
            for name, kind in file.types.items():
                if first.get(name, kind) != kind:
                    return [
                        *notes,
                        f'LeRobot itself cannot load it: column "{name}" is {first[name]} in one'
                        f" data file and {kind} in {path.relative_to(metadata.root)}",
                    ]
    return notes
