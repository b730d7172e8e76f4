"""Undo and redo of deleting paths on a machine, which keeps those that were deleted last."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

from so101_motion.common.errors import MotionError

from ..page import texts
from ..page.saved_files import REDONE, UNDONE
from ..page.screen_state import Sentence


class _Deletion(NamedTuple):
    name: str
    kept_as: str


class Ask(Protocol):
    """Sends the machine a request, unless it is busy with another one."""

    def __call__(
        self,
        command: Mapping[str, Any],
        take: Callable[[Mapping[str, Any]], None],
        *,
        refused: Callable[[], None],
    ) -> None:
        """Send ``command``; ``take`` gets the answer, or ``refused`` is called."""


class MachineDeletions:
    """The paths that were deleted from this page.

    Args:
        ask: Sends the machine a request.
        tell: Called with the outcome, the name of the path, and whether it is there now.
    """

    def __init__(self, ask: Ask, tell: Callable[[Sentence, str, bool], None]) -> None:
        self._ask, self._tell = ask, tell
        self._deletions: list[_Deletion] = []
        self._done = 0  # how many of them are not undone

    @property
    def can_undo(self) -> bool:
        """Whether there is a deletion to undo."""
        return self._done > 0

    @property
    def can_redo(self) -> bool:
        """Whether one was undone."""
        return self._done < len(self._deletions)

    def delete(self, name: str) -> None:
        """Delete a path; what was undone is forgotten."""
        later: list[_Deletion] = []
        self._delete(name, later, texts.deleted(name))

    def redo(self) -> None:
        """Delete again what came back last."""
        if self.can_redo:
            first, *later = self._deletions[self._done :]
            self._delete(first.name, later, REDONE)

    def undo(self) -> None:
        """Bring back what was deleted last; if the machine refuses, none is undone any more."""
        if not self.can_undo:
            return
        name, kept_as = self._deletions[self._done - 1]

        def take(_answer: Mapping[str, Any]) -> None:
            self._done -= 1
            self._tell(UNDONE, name, True)

        self._ask({"command": "restore_path", "kept_as": kept_as}, take, refused=self._forget)

    def _delete(self, name: str, later: list[_Deletion], sentence: Sentence) -> None:
        def take(answer: Mapping[str, Any]) -> None:
            self._tell(sentence, name, False)
            kept_as = answer.get("kept_as")
            if not isinstance(kept_as, str):
                self._forget()
                raise MotionError("the machine's answer does not say how to undo the deletion")
            done = [*self._deletions[: self._done], _Deletion(name, kept_as)]
            self._deletions, self._done = [*done, *later], len(done)

        self._ask({"command": "delete_path", "name": name}, take, refused=self._forget)

    def _forget(self) -> None:
        self._deletions, self._done = [], 0
