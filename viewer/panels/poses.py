"""Save, choose, rename and delete the user's own poses; their folder in the Move tab."""

from __future__ import annotations

from functools import partial

from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.named_poses import NamedPose
from so101_motion.files.saved_poses import SavedPoses

from ..page import texts
from ..page.history import SavedFiles
from ..page.page_context import PageContext
from ..page.screen_state import Sentence, Tone
from ..page.shared_fields import SharedField
from ..view_model import MoveModel


class PoseList:
    """The user's own poses. For the page's thread."""

    def __init__(self, book: SavedPoses, model: MoveModel) -> None:
        self._book, self._model, self._page = book, model, model.arms[""]
        self.saved_files = SavedFiles(lambda _name: book.file(), lambda: (), self._put_back)
        self.poses: tuple[NamedPose, ...] = ()
        self.chosen: str | None = None
        self.name = ""
        try:
            self.poses = book.own()
        except So101Error as error:
            model.report(error)

    def choose(self, name: str) -> None:
        if any(pose.name == name for pose in self.poses):
            self.chosen = self.name = name

    def save_arm(self) -> None:
        self._save(self._page.q_arm)

    def save_target(self) -> None:
        self._save(self._page.target.q)

    def use(self) -> None:
        chosen = self._chosen()
        self._page.set_target_joints(self._book.find(chosen).q)

    def rename(self) -> None:
        chosen = self._chosen()
        with self.saved_files.changing(chosen):
            self._book.rename(chosen, self.name)
        new = self.name.strip()
        self._changed(new, Sentence(f"{chosen} is now called {new}.", Tone.GOOD))

    def delete(self) -> None:
        chosen = self._chosen()
        with self.saved_files.changing(chosen):
            self._book.delete(chosen)
        self._changed(None, texts.deleted(chosen))

    def _put_back(self, sentence: Sentence) -> None:
        self._changed(self.chosen, sentence)

    def _save(self, q: Array) -> None:
        with self.saved_files.changing(self.name):
            pose = self._book.save(self.name, q)
        self._changed(pose.name, Sentence(f"Saved as {pose.name}.", Tone.GOOD))

    def _changed(self, chosen: str | None, sentence: Sentence) -> None:
        self.poses = self._book.own()
        names = [pose.name for pose in self.poses]
        self.chosen = chosen if chosen in names else next(iter(names), None)
        self.name = self.chosen or ""
        self._model.tell(sentence)

    def _chosen(self) -> str:
        if self.chosen is None:
            raise ConfigError("pose", None, "save a pose first")
        return self.chosen


_NONE = "none saved yet"


class PoseFolder:
    """Widgets for the poses of a ``PoseList``, in a folder."""

    def __init__(self, context: PageContext, poses: PoseList) -> None:
        self._poses = poses
        gui = context.gui
        with gui.add_folder("My poses", expand_by_default=False):
            self._list = gui.add_dropdown("Pose", (_NONE,))
            self._use = context.buttons(
                "Chosen pose",
                {"set as target": poses.use, "rename": poses.rename, "delete": poses.delete},
            )
            self._text = gui.add_text("Name", "")
            context.buttons(
                "Save",
                {"current pose": poses.save_arm, "target": poses.save_target},
                "Where the arm is, or where the ghost is",
            )
        self._chosen = SharedField(self._list, poses.choose, context)
        self._name = SharedField(self._text, partial(setattr, poses, "name"), context)

    def show(self) -> None:
        names = tuple(pose.name for pose in self._poses.poses)
        if self._list.options != (names or (_NONE,)):
            self._list.options = names or (_NONE,)
        self._use.visible = bool(names)
        self._chosen.show(self._poses.chosen or (names[0] if names else _NONE))
        self._name.show(self._poses.name)
