"""Undo and redo: of a value that is edited, and of what the page does to the user's files."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from math import inf
from pathlib import Path
from typing import Generic, TypeVar

from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.files import atomic, user_storage

from .screen_state import Sentence

T = TypeVar("T")

_NUMBERS = count(1)  # of changes, so that those of several kinds are undone in one order

ONE_DRAG = 0.7
"""Values of one kind that follow each other faster than this are one change [s]; chosen: a drag, a
slider, somebody who types."""


class History(Generic[T]):
    """The past values of something, the present one, and those that were undone.

    Each change has a number.

    Args:
        restore: Takes the value that was undone or redone to, and which of both in a sentence.
        now: The time [s]; without it each value counts.
    """

    kept = 100  # how many values are remembered; chosen

    def __init__(
        self, value: T, restore: Callable[[T, str], None], now: Callable[[], float] | None = None
    ) -> None:
        self._restore, self._now = restore, now
        self.forget(value)

    def forget(self, value: T) -> None:
        """Have ``value`` now, and nothing to undo."""
        self._values = [value]  # one more than there are changes
        self._numbers: list[int] = []
        self._done = 0  # how many of them are not undone
        self._changed = -inf
        self._kind: Hashable = None

    @property
    def value(self) -> T:
        return self._values[self._done]

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
            self._go(self._done - 1, "Undone.")

    def redo(self) -> None:
        if self.can_redo:
            self._go(self._done + 1, "Redone.")

    def add(self, value: T, kind: Hashable = None) -> None:
        """Take a new value; what was undone is forgotten.

        Values of the same ``kind`` that follow each other fast, as in a drag, count as one.
        """
        before, self._changed = self._changed, inf if self._now is None else self._now()
        is_same = kind is not None and kind == self._kind
        is_same_drag = is_same and self._now is not None and self._changed - before < ONE_DRAG
        self._kind = kind
        done = self._done - 1 if is_same_drag else self._done
        self._values = [*self._values[: done + 1], value][-self.kept :]
        self._numbers = [*self._numbers[:done], next(_NUMBERS)][1 - self.kept :]
        self._done = len(self._numbers)

    def amend(self, value: T) -> None:
        self._values[self._done] = value

    def _go(self, done: int, words: str) -> None:
        self._restore(self._values[done], words)
        self._done, self._changed = done, -inf


_LOOKS_EVERY = 1.0
"""How often the folder is read for files of other programs [s]; chosen, nobody waits for it."""

Contents = Mapping[Path, bytes | None]  # of files that were changed; None for no file


class SavedFiles(History[Contents]):
    """The user's files of one kind, and undo of their changes. For the page's thread.

    Nothing is undone, and ``ConfigError`` raised, if another program has changed the file since.

    Args:
        file_of: The file for a name.
        listed: The names of all files.
        tell: Called with the outcome of undo and redo.
    """

    kept = 20  # chosen: a long path is a file of megabytes

    def __init__(
        self,
        file_of: Callable[[str], Path],
        listed: Callable[[], tuple[str, ...]],
        tell: Callable[[Sentence], None],
    ) -> None:
        super().__init__({}, self._put_back)
        self._file_of, self._listed, self._tell = file_of, listed, tell
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
        if self.value.get(file, before) != before:  # another program has changed it
            self.forget({})
        self.amend({**self.value, file: before})
        self.add({**self.value, file: _content(file)})
        self._look()

    def _put_back(self, wanted: Contents, words: str) -> None:
        for file in wanted.keys() & self.value.keys():
            if wanted[file] != self.value[file]:
                self._put(file, wanted[file])
        self._look()
        self._tell(Sentence(words))

    def _put(self, file: Path, content: bytes | None) -> None:
        with user_storage.locked(file):
            if _content(file) != self.value[file]:
                self.forget({})
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
