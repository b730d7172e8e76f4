"""Read the joints of a LeRobot data set, an episode at a time, in the data set's own units.

Arrays have six columns in the order of ``JOINTS``, whatever order and prefix the data set has.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from so101_motion.calib.record import store
from so101_motion.calib.record.record import JOINTS
from so101_motion.calib.record.store import Stored
from so101_motion.calib.record.zero import encoder_zeros
from so101_motion.common.errors import ConfigError, quoted
from so101_motion.common.geometry import Array
from so101_motion.tasks.datasets.metadata import (
    CALIBRATION,
    EPISODES_2,
    EPISODES_3,
    OTHER_ARMS,
    UNITS,
    Feature,
    Metadata,
    read_lines,
    read_metadata,
    read_object,
    refusal,
)
from so101_motion.tasks.datasets.parquet import Reader, require
from so101_motion.tasks.datasets.units import KINDS, Units, units_of

ACTION, STATE = "action", "observation.state"

TAKEN = ".taken"  # suffix of state names under which our LeRobot robot records the action as taken
MOST_OF_EPISODE = 2_000_000  # frames of an episode, 9 hours at 60 a second; held in memory. Chosen.
LARGEST_NUMBER = 1e6  # larger numbers cannot be angles; they count as missing. Chosen.

_COUNTERS = ("timestamp", "frame_index", "episode_index")
_SIDES = ("left_", "right_")
_NAME = re.compile(r"(left_|right_)?(?:main_|arm_)?(.*?)(?:\.pos)?$", re.DOTALL)
"""A joint's name; LeRobot before June 2025 puts ``main_`` before it, mobile robots ``arm_``."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Episode:
    """The joints of one episode."""

    index: int
    t: Array  # when each frame was taken, shape (n,), [s]
    frame: Array  # the frames' own numbers, shape (n,)
    # where the joints were sent, in the data set's units, shape (n, 6). Numbers that are missing or
    # impossible are NaN.
    action: Array
    state: Array | None  # where they were, likewise; None if it was not recorded
    expected: int | None  # how many frames the metadata says it has; None if it does not say

    def __len__(self) -> int:
        return len(self.t)


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSet:
    """A LeRobot data set of an SO-101, open for reading."""

    metadata: Metadata
    side: str  # the arm of two that is read, ``"left"`` or ``"right"``; empty for the only one
    columns: dict[str, tuple[int | None, ...]]  # index of ``JOINTS`` in a row; None: no jaw

    @property
    def declared(self) -> str:
        """The units that the set itself declares for this arm; empty for none, as LeRobot's."""
        path = self.metadata.root / UNITS
        kind = read_object(path).get("units") if path.is_file() else ""
        kind = kind.get(self.side) if isinstance(kind, dict) else kind
        return kind if isinstance(kind, str) and kind in KINDS else ""

    @property
    def calibration_path(self) -> Path:
        """Where this arm's calibration is, if the set declares it."""
        side = f"_{self.side}" if self.side else ""
        return self.metadata.root / CALIBRATION.format(side=side)

    @property
    def calibration(self) -> Stored | None:
        """The calibration that the numbers were made with; None if the set declares none."""
        path = self.calibration_path.resolve()
        return store.read(path) if path.is_file() else None

    def refuse_other_units(self, units: Units) -> None:
        """Refuse units or a calibration that contradict what the set declares."""
        if self.declared not in ("", units.kind):
            reason = f"contradicts {UNITS} in the data set, which declares {self.declared}"
            raise ConfigError("units", units.kind, reason)
        declared, given = self.calibration, units.calibration
        if declared is None or given is None:
            return
        meant = units_of(units.kind, declared)
        zeros = encoder_zeros(declared.calibration, declared.zeros)
        same = np.allclose([units.factor, units.offset], [meant.factor, meant.offset], atol=1e-4)
        if not same or zeros != encoder_zeros(given.calibration, given.zeros):
            reason = f"is not that of the data set, {self.calibration_path}; leave it out"
            raise ConfigError("calibration", str(given.path), reason)

    def angles(self, name: str) -> Iterator[tuple[int | None, ...]]:
        """The indices of ``JOINTS`` in a row of a column, for each set of angles in it.

        A state may also have the action as it was taken; see ``TAKEN``.
        """
        yield self.columns[name]
        names = self.metadata.features[name].names
        side = f"{self.side}_" if self.side else ""
        kept = [f"{side}{joint}{TAKEN}" for joint in JOINTS]
        if any(each in names for each in kept):
            yield tuple(names.index(each) if each in names else None for each in kept)

    @property
    def has_state(self) -> bool:
        return STATE in self.columns

    @property
    def has_jaw(self) -> bool:
        return all(places[-1] is not None for places in self.columns.values())

    def episodes(self) -> Iterator[Episode]:
        """All episodes, each read when it is iterated; ``ConfigError`` if a file is broken."""
        lengths = self.announced()
        seen: set[int] = set()
        pieces: list[Array] = []
        current: int | None = None
        held = 0
        for rows in self._rows():
            numbers = rows[:, 2]
            for begin, end in stretches(numbers):
                number = self._number(numbers[begin])
                if number != current:
                    if current is not None:
                        yield self._episode(current, pieces, lengths)
                    if number in seen:
                        raise refusal(self.metadata.root, f"episode {number} is not in one piece")
                    seen.add(number)
                    current, pieces, held = number, [], 0
                pieces.append(rows[begin:end])
                held += end - begin
                if held > MOST_OF_EPISODE:
                    reason = f"episode {number} has more than {MOST_OF_EPISODE} frames"
                    raise refusal(self.metadata.root, reason)
        if current is not None:
            yield self._episode(current, pieces, lengths)

    def episode(self, number: int) -> Episode:
        """Read one episode; ``ConfigError`` if there is none, or a file is broken."""
        numbers = []
        for found in self.episodes():
            if found.index == number:
                return found
            numbers.append(found.index)
        there = f"{numbers[0]} to {numbers[-1]}" if numbers else "none"
        raise refusal(self.metadata.root, f"has no episode {number}; there are {there}")

    def announced(self) -> dict[int, int]:
        """How many frames each episode has by the metadata; empty if it does not say."""
        root = self.metadata.root
        if self.metadata.is_v3:
            found: dict[int, int] = {}
            for path in sorted((root / EPISODES_3).glob("*/*.parquet")):
                with Reader(path) as file:
                    for batch in file.batches(("episode_index", "length"), {}):
                        numbers = np.column_stack([batch["episode_index"], batch["length"]])
                        known = numbers[np.isfinite(numbers).all(axis=1)].astype(int)
                        found |= dict(known.tolist())
            return found
        rows = read_lines(root / EPISODES_2) if (root / EPISODES_2).exists() else []
        return {
            row["episode_index"]: row["length"]
            for row in rows
            if isinstance(row.get("episode_index"), int) and isinstance(row.get("length"), int)
        }

    def _rows(self) -> Iterator[Array]:
        """Rows of time, frame, episode, action and state, shape (m, 3 + 6 or 12)."""
        widths = {name: len(self.metadata.features[name].names) for name in self.columns}
        for path in self.metadata.data_files():
            with Reader(path) as file:
                for batch in file.batches(_COUNTERS, widths):
                    parts = [np.column_stack([batch[name] for name in _COUNTERS])]
                    parts += [_taken(batch[name], self.columns[name]) for name in self.columns]
                    yield np.concatenate(parts, axis=1)

    def _number(self, value: float) -> int:
        if not np.isfinite(value) or value % 1 != 0 or not 0 <= value < 1e9:
            reason = f"episode_index must be a whole number, not {quoted(float(value))}"
            raise refusal(self.metadata.root, reason)
        return int(value)

    def _episode(self, number: int, pieces: list[Array], lengths: dict[int, int]) -> Episode:
        rows = np.concatenate(pieces)
        return Episode(
            index=number,
            t=rows[:, 0].copy(),
            frame=rows[:, 1].copy(),
            action=rows[:, 3:9].copy(),
            state=rows[:, 9:15].copy() if self.has_state else None,
            expected=lengths.get(number),
        )


def open_data_set(root: Path, *, side: str = "") -> DataSet:
    """Open a LeRobot data set of version 2.0, 2.1 or 3; reads its metadata only.

    Args:
        root: The folder that holds ``meta`` and ``data``.
        side: The arm to read, if the data set is of two: ``"left"`` or ``"right"``.

    Raises:
        ConfigError: It is not a data set, lacks a joint of the arm, or pyarrow is not installed.
    """
    require()
    metadata = read_metadata(root)
    if metadata.robot.removeprefix("bi_").startswith(OTHER_ARMS):
        reason = f"was recorded on {quoted(metadata.robot)}, which is not an SO-101: its links,"
        raise refusal(root, f"{reason} zeros and travels are others")
    if ACTION not in metadata.features:
        raise refusal(root, f'has no column "{ACTION}"')
    columns = {
        name: _places(root, name, metadata.features[name], side)
        for name in (ACTION, STATE)
        if name in metadata.features
    }
    return DataSet(metadata=metadata, side=side, columns=columns)


def _places(root: Path, column: str, feature: Feature, side: str) -> tuple[int | None, ...]:
    """The place of each joint in a column."""
    prefix = f"{side}_" if side else ""
    plain = ["".join(_NAME.findall(name)[0]) for name in feature.names]
    places = {name: place for place, name in enumerate(plain)}
    missing = [joint for joint in JOINTS[:5] if prefix + joint not in places]
    if missing:
        if not side and all(f"{each}{JOINTS[0]}" in places for each in _SIDES):
            raise refusal(root, "is of two arms; choose one: left or right")
        there = ", ".join(feature.names[:12]) or "no names"
        reason = f'"{column}" lacks {", ".join(missing)} of an SO-101; it has {there}'
        raise refusal(root, reason)
    if len(places) != len(plain):
        raise refusal(root, f'"{column}" has a joint twice')
    return tuple(places.get(prefix + joint) for joint in JOINTS)


def stretches(numbers: Array) -> Iterator[tuple[int, int]]:
    """Where equal numbers begin and end, shape (n,), as first index and the one after the last."""
    cuts = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    yield from ((begin, end) for begin, end in pairwise(cuts) if begin < end)


def _taken(values: NDArray[np.float64], places: tuple[int | None, ...]) -> Array:
    """The six joints of some rows; impossible numbers become NaN."""
    taken = np.full((len(values), len(JOINTS)), np.nan)
    for i, place in enumerate(places):
        if place is not None:
            taken[:, i] = values[:, place]
    with np.errstate(invalid="ignore"):
        taken[~(np.abs(taken) <= LARGEST_NUMBER)] = np.nan
    return taken
