"""Convert a data set to other units or another calibration; the model's angles stay the same.

The source is only read; all but numbers and statistics is copied or linked. Statistics of an
episode are exact; those of all are combined as LeRobot 0.6.1 does (``aggregate_feature_stats``):
quantiles, too, are means weighted by frames.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.calib.record.versions import zero_path
from so101_motion.calib.record.zero import zeros_text
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_rad
from so101_motion.files import atomic
from so101_motion.tasks.datasets.data_set import DataSet, stretches
from so101_motion.tasks.datasets.metadata import (
    EPISODE_STATS_2,
    EPISODES_3,
    STATS,
    UNITS,
    read_lines,
    read_object,
    refusal,
    why_broken,
)
from so101_motion.tasks.datasets.parquet import Reader, Table, with_lists, with_vectors
from so101_motion.tasks.datasets.units import Units

Statistics = dict[str, list[float]]  # by LeRobot's names: ``min``, ``std``, ``count``, ``q01`` ...

_QUANTILE = re.compile(r"q\d\d")


def of_episode(values: Array, names: Collection[str]) -> Statistics:
    """The statistics of the rows of an episode, shape (n, d); unknown names are left out."""
    found: Statistics = {}
    for name in names:
        if name == "count":
            found[name] = [len(values)]
        elif name in ("min", "max", "mean", "std"):
            found[name] = getattr(np, name)(values, axis=0).tolist()
        elif _QUANTILE.fullmatch(name):
            found[name] = np.quantile(values, int(name[1:]) / 100.0, axis=0).tolist()
    return found


def together(episodes: Iterable[Statistics], names: Collection[str]) -> Statistics:
    """Combine the statistics of one episode or more, which have count, mean and std."""
    every = list(episodes)
    count = np.array([each["count"][0] for each in every], dtype=float)
    weight = (count / count.sum())[:, None]

    def column(name: str) -> Array:
        return np.array([each[name] for each in every], dtype=float)

    mean = (weight * column("mean")).sum(axis=0)
    found: Statistics = {}
    for name in names:
        if name == "count":
            found[name] = [int(count.sum())]
        elif name == "mean":
            found[name] = mean.tolist()
        elif name == "std":
            spread = np.square(column("std")) + np.square(column("mean") - mean)
            found[name] = np.sqrt((weight * spread).sum(axis=0)).tolist()
        elif name in ("min", "max"):
            found[name] = getattr(np, name)(column(name), axis=0).tolist()
        elif _QUANTILE.fullmatch(name):
            found[name] = (weight * column(name)).sum(axis=0).tolist()
    return found


_ALL = ("min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99")
_BEYOND = to_rad(0.5)  # a joint farther outside its new travel than this counts as beyond it


@dataclass(frozen=True, slots=True, kw_only=True)
class Conversion:
    """The result of a conversion."""

    episodes: int  # how many episodes it has
    frames: int  # how many frames it has
    # in how many frames each arm joint is beyond the travel of the new calibration, in action or
    # state. They are kept; LeRobot would clip them.
    beyond: Mapping[str, int]


def convert_data_set(
    data_set: DataSet, path: Path, *, source: Units, target: Units, link: bool = False
) -> Conversion:
    """Write a copy of a data set in other units.

    Args:
        data_set: The data set to convert; its files stay as they are.
        path: The folder to make; it must not exist.
        source: Units of its numbers.
        target: Units of the new numbers.
        link: Whether videos, images and other files that stay the same become hard links.

    Raises:
        ConfigError: The data set declares other units, the folder exists or cannot be written, or
            the source is broken.
    """
    data_set.refuse_other_units(source)
    root = data_set.metadata.root.resolve()
    for pointer in data_set.metadata.lfs_pointers():
        raise refusal(pointer, why_broken(pointer))
    _refuse_place(root, path)
    try:
        with _whole_or_not_at_all(path) as folder:
            run = _Run(data_set, folder, source, target)
            run.write(link=link)
    except OSError as error:
        reason = f"cannot be written: {error.strerror or error}"
        raise ConfigError("out", str(path), reason) from error
    return Conversion(
        episodes=len(run.lengths), frames=sum(run.lengths.values()), beyond=run.beyond
    )


def _refuse_place(root: Path, path: Path) -> None:
    place = path.resolve()
    if place == root or root in place.parents or place in root.parents:
        raise ConfigError("out", str(path), "must be outside of the data set that is converted")
    if path.exists() or path.is_symlink():
        raise ConfigError("out", str(path), "is there already; choose another name")
    if not place.parent.is_dir():
        raise ConfigError("out", str(path), "is in a folder that does not exist; make it first")


@contextmanager
def _whole_or_not_at_all(path: Path) -> Iterator[Path]:
    """Yield a folder that becomes ``path`` if the block succeeds, and is removed if not."""
    place = path.resolve()
    folder = place.with_name(f".{place.name}.{os.getpid()}.tmp")
    folder.mkdir()
    try:
        yield folder
        for found in folder.rglob("*"):
            if found.is_dir():
                atomic.flush(found)
        atomic.flush(folder)
        if place.exists():  # made by somebody meanwhile
            raise ConfigError("out", str(path), "is there already; choose another name")
        folder.rename(place)
        atomic.flush(place.parent)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


class _Run:
    def __init__(self, data_set: DataSet, folder: Path, source: Units, target: Units) -> None:
        self._set, self._root, self._folder = data_set, data_set.metadata.root, folder
        self._source, self._target = source, target
        self.lengths: dict[int, int] = {}
        self.beyond = dict.fromkeys(ARM_JOINTS, 0)
        self._statistics: dict[str, dict[int, Statistics]] = {name: {} for name in data_set.columns}
        self._pieces: dict[str, list[Array]] = {name: [] for name in data_set.columns}
        self._current: int | None = None

    def write(self, *, link: bool) -> None:
        written = set()
        for path in self._set.metadata.data_files():
            new = self._made(path.relative_to(self._root))
            with Reader(path) as file:
                file.rewrite(new, self._changed(file))
            written.add(new)
        self._end_episode()
        if lost := sorted(set(self._set.announced()) - set(self.lengths)):
            raise refusal(self._root, f"its metadata names episode {lost[0]}, which has no frames")
        written |= set(self._write_statistics())
        content = {"schema": "so101/data-set-units/1", "units": self._declaration()}
        written.add(self._write_text(UNITS, json.dumps(content, indent=2)))
        written |= self._write_calibration()
        self._copy_others(written, link=link)

    def _declaration(self) -> str | dict[str, str]:
        """The new units; of two arms by side, with what was declared for the other one."""
        if not self._set.side:
            return self._target.kind
        arms = {side: replace(self._set, side=side).declared for side in ("left", "right")}
        arms[self._set.side] = self._target.kind
        return {side: kind for side, kind in arms.items() if kind}

    def _write_calibration(self) -> set[Path]:
        """Write the new calibration, if it is known; one that is there already is left out."""
        place, known = self._set.calibration_path.relative_to(self._root), self._target.calibration
        beside = zero_path(place)
        if known is not None:
            entries = {joint: entry.to_json() for joint, entry in known.calibration.items()}
            self._write_text(place, json.dumps(entries, indent=4))
            zeros = zeros_text((known.calibration, known.zeros))
            self._write_text(beside, zeros.decode())
        return {self._made(each) for each in (place, beside)}

    # Frames

    def _changed(self, file: Reader) -> Callable[[Table], Table]:
        def change(table: Table) -> Table:
            rows, outside = {}, np.zeros((table.num_rows, 5), dtype=bool)
            for name in self._set.columns:
                width = len(self._set.metadata.features[name].names)
                rows[name] = file.vectors_of(table, name, width)
                outside |= self._convert(name, rows[name])
                table = with_vectors(table, name, rows[name])
            for joint, count in zip(ARM_JOINTS, outside.sum(axis=0).tolist(), strict=True):
                self.beyond[joint] += count
            self._keep(self._numbers(table), rows)
            return table

        return change

    def _numbers(self, table: Table) -> Array:
        if "episode_index" not in table.column_names:
            raise refusal(self._root, 'has a data file without a column "episode_index"')
        column = table.column("episode_index").to_numpy()
        try:
            numbers = np.asarray(column, dtype=float)
        except (TypeError, ValueError):
            numbers = np.full(len(column), np.nan)
        if numbers.ndim != 1 or not (np.isfinite(numbers) & (numbers % 1 == 0)).all():
            raise refusal(self._root, "episode_index must be whole numbers")
        return numbers

    def _convert(self, name: str, values: Array) -> Array:
        """Convert rows in place; say where each arm joint is beyond its new travel, (n, 5)."""
        outside = np.zeros((len(values), 5), dtype=bool)
        jaw_stays = not (self._source.is_jaw_known and self._target.is_jaw_known)
        for i, place in (each for places in self._set.angles(name) for each in enumerate(places)):
            if place is None or (i == 5 and jaw_stays):  # its per cent of the travel stay the same
                continue
            q = values[:, place] * self._source.factor[i] + self._source.offset[i]
            values[:, place] = (q - self._target.offset[i]) / self._target.factor[i]
            if i < 5:
                lower, upper = self._target.lower[i] - _BEYOND, self._target.upper[i] + _BEYOND
                outside[:, i] |= (q < lower) | (q > upper)
        return outside

    # Statistics

    def _keep(self, numbers: Array, rows: Mapping[str, Array]) -> None:
        """Keep converted rows until their episode is over."""
        for begin, end in stretches(numbers):
            number = int(numbers[begin])
            if number != self._current:
                self._end_episode()
                if number in self.lengths:
                    raise refusal(self._root, f"episode {number} is not in one piece")
                self._current = number
            for name, values in rows.items():
                self._pieces[name].append(values[begin:end])

    def _end_episode(self) -> None:
        if self._current is None:
            return
        for name, pieces in self._pieces.items():
            rows = np.concatenate(pieces)
            self._statistics[name][self._current] = of_episode(rows, _ALL)
            self.lengths[self._current] = len(rows)
            pieces.clear()

    def _write_statistics(self) -> Iterator[Path]:
        """Write the files that hold statistics, with those of the converted columns anew."""
        if (self._root / STATS).is_file():
            content = read_object(self._root / STATS)
            for name, found in self._statistics.items():
                if isinstance(content.get(name), dict) and found:
                    content[name] = together(found.values(), content[name])
            yield self._write_text(STATS, json.dumps(content, indent=4))
        if (self._root / EPISODE_STATS_2).is_file():
            rows = read_lines(self._root / EPISODE_STATS_2)
            lines = [json.dumps(self._with_statistics(row)) + "\n" for row in rows]
            yield self._write_text(EPISODE_STATS_2, "".join(lines))
        if self._set.metadata.is_v3:
            for path in sorted((self._root / EPISODES_3).glob("*/*.parquet")):
                new = self._made(path.relative_to(self._root))
                with Reader(path) as file:
                    file.rewrite(new, self._with_columns)
                yield new

    def _with_statistics(self, row: dict[str, Any]) -> dict[str, Any]:
        """A line of ``episodes_stats.jsonl`` with the new statistics."""
        stats = row.get("stats")
        for name, found in self._statistics.items():
            known = found.get(row["episode_index"]) if "episode_index" in row else None
            if isinstance(stats, dict) and isinstance(stats.get(name), dict) and known:
                stats[name] = {key: known[key] for key in stats[name] if key in known}
        return row

    def _with_columns(self, table: Table) -> Table:
        """Rows of ``meta/episodes`` with new statistics, a column each: ``stats/action/min``."""
        numbers = [int(number) for number in self._numbers(table)]
        for name, found in self._statistics.items():
            for key in _ALL:
                if f"stats/{name}/{key}" in table.column_names:
                    rows = [found[number][key] for number in numbers]
                    table = with_lists(table, f"stats/{name}/{key}", rows)
        return table

    # Files

    def _made(self, relative: Path) -> Path:
        place = self._folder / relative
        place.parent.mkdir(parents=True, exist_ok=True)
        return place

    def _write_text(self, relative: Path, text: str) -> Path:
        place = self._made(relative)
        place.write_text(text, encoding="utf-8")
        return place

    def _copy_others(self, written: set[Path], *, link: bool) -> None:
        """Copy or link every other file; hidden folders, such as a cache, are left out."""
        for folder, folders, names in os.walk(self._root):
            folders[:] = [name for name in folders if not name.startswith(".")]
            for name in folders:
                if (Path(folder) / name).is_symlink():
                    reason = f"{name} is a link to a folder; put the folder in its place"
                    raise refusal(Path(folder), reason)
            for name in names:
                path = Path(folder) / name
                relative = path.relative_to(self._root)
                new = self._made(relative)
                if new not in written and path.is_file():
                    _copy(path.resolve(), new, link=link and relative.parts[0] != "meta")
        for path in self._folder.rglob("*"):
            if path.is_file():
                atomic.flush(path)


def _copy(path: Path, new: Path, *, link: bool) -> None:
    if link:
        try:
            os.link(path, new)
            return
        except OSError:  # another disk, or a file system without links
            pass
    shutil.copyfile(path, new)
