"""Undo and redo: of a value that is edited, and of what the page does to the user's files."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from math import inf
from pathlib import Path
from typing import Generic, TypeVar

from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.files import atomic, user_storage

from .screen_state import Sentence

T = TypeVar("T")

_NUMBERS = count(1)  # of changes, so that those of several kinds are undone in one order

KEPT = 100  # how many values are remembered; chosen

ONE_DRAG = 0.7
"""Values of one kind that follow each other faster than this are one change [s]; chosen: a drag, a
slider, somebody who types."""


class Undoable(ABC):
    """Changes that can be undone and made again, each with its number."""

    def __init__(self) -> None:
        self._numbers: list[int] = []
        self._done = 0  # how many of them are not undone

    @property
    def can_undo(self) -> bool:
        return self._done > 0

    @property
    def can_redo(self) -> bool:
        return self._done < len(self._numbers)

    @property
    def undoes(self) -> int:
        """The number of the change that ``undo`` takes back; 0 for none."""
        return self._numbers[self._done - 1] if self.can_undo else 0

    @property
    def redoes(self) -> float:
        """The number of the change that ``redo`` makes again; infinite for none."""
        return self._numbers[self._done] if self.can_redo else inf

    def undo(self) -> None:
        if self.can_undo:
            self._go(self._done - 1, forward=False)

    def redo(self) -> None:
        if self.can_redo:
            self._go(self._done, forward=True)

    @abstractmethod
    def _go(self, change: int, *, forward: bool) -> None:
        """Make the change of this index again, or take it back; then count it in ``_done``."""


class History(Undoable, Generic[T]):
    """The past values of something, the present one, and those that were undone.

    Args:
        restore: Takes the value that was undone or redone to, and which of both in a sentence.
        now: The time [s]; without it each value counts.
    """

    def __init__(
        self,
        value: T,
        restore: Callable[[T, str], None],
        now: Callable[[], float] | None = None,
    ) -> None:
        super().__init__()
        self._values, self._restore = [value], restore  # one more than there are changes
        self._now, self._changed = now, -inf
        self._kind: Hashable = None

    def add(self, value: T, kind: Hashable = None) -> None:
        """Take a new value; what was undone is forgotten.

        Values of the same ``kind`` that follow each other fast, as in a drag, count as one.
        """
        before, self._changed = self._changed, inf if self._now is None else self._now()
        is_same = kind is not None and kind == self._kind
        is_same_drag = is_same and self._now is not None and self._changed - before < ONE_DRAG
        self._kind = kind
        kept = self._done - 1 if is_same_drag else self._done
        self._values = [*self._values[: kept + 1], value][-KEPT:]
        self._numbers = [*self._numbers[:kept], next(_NUMBERS)][1 - KEPT :]
        self._done = len(self._numbers)

    def amend(self, value: T) -> None:
        self._values[self._done] = value

    def _go(self, change: int, *, forward: bool) -> None:
        done = change + 1 if forward else change
        self._restore(self._values[done], "Redone." if forward else "Undone.")
        self._done, self._changed = done, -inf


_KEPT_FILES = 20  # how many changes are remembered; chosen, a long path is a file of megabytes

_LOOKS_EVERY = 1.0
"""How often the folder is read for files of other programs [s]; chosen, nobody waits for it."""

UNDONE = Sentence("Undone: the saved files are as before.")
REDONE = Sentence("Redone.")


@dataclass(frozen=True, slots=True)
class _Change:
    """What a file held before a change and after it; None for no file."""

    file: Path
    before: bytes | None
    after: bytes | None


class SavedFiles(Undoable):
    """The user's files of one kind, and undo of their changes. For the page's thread.

    Nothing is undone, and ``ConfigError`` raised, if another program has changed the file since.

    Args:
        file_of: The file for a name.
        listed: The names of all files.
        tell: Called with the outcome of undo and redo.
    """

    def __init__(
        self,
        file_of: Callable[[str], Path],
        listed: Callable[[], tuple[str, ...]],
        tell: Callable[[Sentence], None],
    ) -> None:
        super().__init__()
        self._file_of, self._listed, self._tell = file_of, listed, tell
        self._changes: list[_Change] = []
        self.names: tuple[str, ...] = ()
        self._looked_at = -inf
        self._look()

    def look_again(self, now: float) -> None:
        """Read the names again, at most once a second: other programs write files as well."""
        if now - self._looked_at >= _LOOKS_EVERY:
            self._looked_at = now
            self._look()

    @contextmanager
    def changing(self, name: str) -> Iterator[Path]:
        """Note what is done to the file of ``name`` inside, unless that fails."""
        file = self._file_of(name)
        before = _content(file)
        yield file
        change = _Change(file, before, _content(file))
        self._changes = [*self._changes[: self._done], change][-_KEPT_FILES:]
        self._numbers = [*self._numbers[: self._done], next(_NUMBERS)][-_KEPT_FILES:]
        self._done = len(self._changes)
        self._look()

    def _go(self, change: int, *, forward: bool) -> None:
        made = self._changes[change]
        if forward:
            self._put(made.file, made.before, made.after)
        else:
            self._put(made.file, made.after, made.before)
        self._done = change + 1 if forward else change
        self._look()
        self._tell(REDONE if forward else UNDONE)

    def _put(self, file: Path, expected: bytes | None, content: bytes | None) -> None:
        with user_storage.locked(file):
            if _content(file) != expected:
                self._changes, self._numbers, self._done = [], [], 0
                raise ConfigError(
                    "file", str(file), "was changed by another program, so nothing was undone"
                )
            if content is None:
                file.unlink()
            else:
                atomic.write(file, content)

    def _look(self) -> None:
        try:
            self.names = self._listed()
        except So101Error:
            self.names = ()


def _content(file: Path) -> bytes | None:
    try:
        return file.read_bytes()
    except OSError:
        return None
