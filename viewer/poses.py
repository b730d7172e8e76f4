"""The user's own poses, as the page keeps them: what is saved, which is chosen, what to call it."""

from __future__ import annotations

from collections.abc import Callable

from so101_motion.errors import ConfigError, So101Error
from so101_motion.geometry import Array
from so101_motion.named_poses import NamedPose
from so101_motion.pose_book import PoseBook

from . import words
from .screen import Sentence
from .view_model import ViewModel


class PoseShelf:
    """Poses of the user's own, at hand. Belongs to the page's thread.

    Args:
        book: Where they are kept.
        page: Has the arm and the target, and says what came of it.

    Attributes:
        poses: As they were read last; the file is read again with every change.
        chosen: Name of the one to be used, or None.
        name: What the next one is called.
    """

    def __init__(self, book: PoseBook, page: ViewModel) -> None:
        self._book, self._page = book, page
        self.poses: tuple[NamedPose, ...] = ()
        self.chosen: str | None = None
        self.name = ""
        try:
            self.poses = book.own()
        except So101Error as error:
            page.report(error)

    def choose(self, name: str) -> None:
        """Let the pose ``name`` be the one to be used."""
        if any(pose.name == name for pose in self.poses):
            self.chosen = self.name = name

    def call(self, name: str) -> None:
        """Note what the next pose, or a renamed one, shall be called."""
        self.name = name

    def save_arm(self) -> None:
        """Keep where the arm is."""
        self._save(self._page.q_arm)

    def save_target(self) -> None:
        """Keep where the ghost is."""
        self._save(self._page.aim.q)

    def aim(self) -> None:
        """Make the chosen pose the target."""
        chosen = self._chosen()
        self._page.aim_at_joints(next(pose.q for pose in self.poses if pose.name == chosen))

    def rename(self) -> None:
        """Call the chosen pose by the name that was typed."""
        chosen = self._chosen()
        self._book.rename(chosen, self.name)
        self._changed(self.name.strip(), words.renamed(chosen, self.name.strip()))

    def delete(self) -> None:
        """Forget the chosen pose."""
        chosen = self._chosen()
        self._book.delete(chosen)
        self._changed(None, words.deleted(chosen))

    def _save(self, q: Array) -> None:
        pose = self._book.save(self.name, q)
        self._changed(pose.name, words.saved(pose.name))

    def _changed(self, chosen: str | None, said: Sentence) -> None:
        self.poses = self._book.own()
        first = self.poses[0].name if self.poses else None
        self.chosen = first if chosen is None else chosen
        self.name = self.chosen or ""
        self._page.tell(said)

    def _chosen(self) -> str:
        if self.chosen is None:
            raise ConfigError("pose", None, "is not chosen; save one first")
        return self.chosen


COMMANDS: dict[str, Callable[[PoseShelf], None]] = {
    "aim": PoseShelf.aim,
    "rename": PoseShelf.rename,
    "delete": PoseShelf.delete,
}
"""What can be done with the chosen pose, by the names on the buttons."""

SOURCES: dict[str, Callable[[PoseShelf], None]] = {
    "arm": PoseShelf.save_arm,
    "target": PoseShelf.save_target,
}
"""What can be saved, likewise."""
