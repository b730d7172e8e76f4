"""The user's files of one kind, with undo of what the page does to them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf
from pathlib import Path

from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.files import atomic, user_storage

from .screen_state import Sentence

_KEPT = 20
"""How many changes are remembered; chosen, a long path is a file of megabytes."""

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


class SavedFiles:
    """The user's files of one kind, and undo of their changes. For the page's thread.

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
        self._file_of, self._listed, self._tell = file_of, listed, tell
        self._changes: list[_Change] = []
        self._done = 0  # how many of them are not undone
        self.names: tuple[str, ...] = ()
        self._looked_at = -inf
        self._look()

    @property
    def can_undo(self) -> bool:
        return self._done > 0

    @property
    def can_redo(self) -> bool:
        return self._done < len(self._changes)

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
        self._changes = [*self._changes[: self._done], change][-_KEPT:]
        self._done = len(self._changes)
        self._look()

    def undo(self) -> None:
        """Undo the last change; ``ConfigError`` if another program has changed the file since."""
        if self.can_undo:
            change = self._changes[self._done - 1]
            self._put(change.file, change.after, change.before)
            self._done -= 1
            self._look()
            self._tell(UNDONE)

    def redo(self) -> None:
        if self.can_redo:
            change = self._changes[self._done]
            self._put(change.file, change.before, change.after)
            self._done += 1
            self._look()
            self._tell(REDONE)

    def _put(self, file: Path, expected: bytes | None, content: bytes | None) -> None:
        with user_storage.locked(file):
            if _content(file) != expected:
                self._changes, self._done = [], 0
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
