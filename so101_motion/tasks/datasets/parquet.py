"""Read and write Parquet files; the only place that uses pyarrow (extra ``dataset``).

Files are not trusted: sizes that a file declares are checked before any value is read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.errors import ConfigError, clipped
from so101_motion.tasks.datasets.metadata import refusal, why_broken

ROWS = 8192  # rows that are read at a time
MOST_FRAMES = 20_000_000  # most rows of a data file; 90 hours at 60 frames a second. Chosen.

MOST_BYTES = 8_000_000_000
"""Largest unpacked size that a file may declare [byte]. Chosen: an episode may hold its images.
Only the wanted columns of some thousand rows are held in memory."""

_HOW = "needs pyarrow, which is not installed; try: pip install 'so101-motion[dataset]'"

Table = Any  # pyarrow's, which has no types


def with_vectors(table: Table, name: str, values: NDArray[np.float64]) -> Table:
    """Replace the numbers in a column of lists, shape (n, length); its type stays."""
    arrow, _ = _arrow()
    place, field = table.column_names.index(name), table.schema.field(name)
    flat = arrow.array(values.ravel(), arrow.float64())
    column = arrow.FixedSizeListArray.from_arrays(flat, values.shape[1])
    return table.set_column(place, field, column.cast(field.type, safe=False))


def with_lists(table: Table, name: str, rows: Sequence[Sequence[float]]) -> Table:
    """Replace the lists in a column, one a row; its type stays."""
    arrow, _ = _arrow()
    place, field = table.column_names.index(name), table.schema.field(name)
    return table.set_column(place, field, arrow.array([list(row) for row in rows], field.type))


def require() -> None:
    _arrow()


def _arrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.compute
        import pyarrow.parquet
    except ImportError as error:
        raise ConfigError("data set", None, _HOW) from error
    return pyarrow, pyarrow.parquet


class Reader:
    """An open Parquet file; ``ConfigError`` if it cannot be one of a data set."""

    def __init__(self, path: Path) -> None:
        self._arrow, self._parquet = _arrow()
        self._path = path
        try:
            self._file = self._parquet.ParquetFile(str(path), memory_map=False, pre_buffer=False)
            self.rows = int(self._file.metadata.num_rows)
            schema = self._file.schema_arrow
            self.columns = tuple(str(name) for name in schema.names)
            self.types = {str(each.name): str(each.type) for each in schema}
        except Exception as error:  # whatever a broken file makes pyarrow raise
            raise self._broken(error) from error
        if not 0 <= self.rows <= MOST_FRAMES:
            self._file.close()
            raise refusal(path, f"declares {self.rows} rows; at most {MOST_FRAMES} are read")

    def __enter__(self) -> Reader:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._file.close()

    def batches(self, scalars: Sequence[str], vectors: dict[str, int]) -> Iterator[dict[str, Any]]:
        """The rows of some columns, at most ``ROWS`` at a time, by name; missing numbers are NaN.

        ``scalars`` have a number a row and give shape (n,), ``vectors`` a list of a length and give
        (n, length). ``ConfigError`` if a column is missing or has another type, or the file is
        broken.
        """
        wanted = (*scalars, *vectors)
        self._bound(wanted)
        try:
            found = self._file.iter_batches(
                batch_size=ROWS, columns=list(wanted), use_threads=False
            )
            for batch in found:
                yield {
                    **{name: self._scalars(name, batch.column(name)) for name in scalars},
                    **{
                        name: self._vectors(name, batch.column(name), length)
                        for name, length in vectors.items()
                    },
                }
        except ConfigError:
            raise
        except Exception as error:
            raise self._broken(error) from error

    def rewrite(self, path: Path, change: Callable[[Table], Table]) -> None:
        """Write a copy of the file, each group of rows as ``change`` returns it.

        Types, row groups and file metadata stay. ``ConfigError`` if the file is broken, ``OSError``
        if the new one cannot be written.
        """
        self._bound(())
        with self._parquet.ParquetWriter(str(path), self._file.schema_arrow) as writer:
            for k in range(self._file.metadata.num_row_groups):
                try:
                    table = self._file.read_row_group(k, use_threads=False)
                except Exception as error:
                    raise self._broken(error) from error
                writer.write_table(change(table))

    def vectors_of(self, table: Table, name: str, length: int) -> NDArray[np.float64]:
        """A column of lists of a table of this file, shape (n, length)."""
        chunks = table.column(name).chunks
        parts = [self._vectors(name, chunk, length) for chunk in chunks]
        return np.concatenate([np.zeros((0, length)), *parts])

    def _bound(self, wanted: Sequence[str]) -> None:
        """Refuse a file that lacks wanted columns, or is larger than it can be."""
        for name in wanted:
            if self.columns.count(name) != 1:
                there = ", ".join(self.columns[:12])
                raise refusal(self._path, f'has no column "{name}"; it has {there}')
        # The footer has sizes of columns too, but reading those of a broken file ends the process.
        try:
            groups = range(self._file.metadata.num_row_groups)
            total = sum(int(self._file.metadata.row_group(k).total_byte_size) for k in groups)
        except Exception as error:
            raise self._broken(error) from error
        if total > MOST_BYTES:
            raise refusal(self._path, f"unpacks to {total} bytes; at most {MOST_BYTES} are read")

    def _scalars(self, name: str, column: Any) -> NDArray[np.float64]:
        types = self._arrow.types
        if types.is_fixed_size_list(column.type) or types.is_list(column.type):
            return self._vectors(name, column, 1)[:, 0]
        if not self._is_number(column.type):
            raise refusal(self._path, f'column "{name}" must hold numbers, not {column.type}')
        return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)

    def _vectors(self, name: str, column: Any, length: int) -> NDArray[np.float64]:
        types, kind = self._arrow.types, column.type
        is_list = types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)
        if not (is_list and self._is_number(kind.value_type)):
            raise refusal(self._path, f'column "{name}" must hold lists of numbers, not {kind}')
        if column.null_count:
            raise refusal(self._path, f'column "{name}" is empty in some rows')
        lengths = np.asarray(self._arrow.compute.list_value_length(column))
        if np.any(lengths != length):
            raise refusal(self._path, f'column "{name}" must hold {length} numbers in every row')
        values = column.flatten().to_numpy(zero_copy_only=False)
        return np.asarray(values, dtype=np.float64).reshape(-1, length)

    def _is_number(self, kind: Any) -> bool:
        return bool(self._arrow.types.is_floating(kind) or self._arrow.types.is_integer(kind))

    def _broken(self, error: Exception) -> ConfigError:
        said = clipped(" ".join(str(error).split()), 200)
        why = why_broken(self._path) if self._path.is_file() else ""
        return refusal(self._path, why or f"is not a readable Parquet file: {said}")
