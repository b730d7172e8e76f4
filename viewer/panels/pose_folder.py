"""The folder with the user's own poses, in the Move tab."""

from __future__ import annotations

from ..page.page_context import PageContext
from ..page.shared_fields import SharedField, UndoButtons
from .poses import COMMANDS, SOURCES, PoseList

_NONE = "none saved yet"


class PoseFolder:
    """Widgets for the poses of a ``PoseList``."""

    def __init__(self, context: PageContext, poses: PoseList) -> None:
        self._poses = poses
        gui = context.gui
        with gui.add_folder("My poses", expand_by_default=False):
            self._list = gui.add_dropdown("Pose", (_NONE,))
            self._use = gui.add_button_group("Chosen pose", tuple(COMMANDS))
            self._text = gui.add_text("Name", "")
            save = gui.add_button_group(
                "Save", tuple(SOURCES), hint="Where the arm is, or where the ghost is"
            )
            self._undo = UndoButtons(context, "Saved poses", poses.saved_files)
        self._chosen = SharedField(self._list, poses.choose, context, shown=str)
        self._name = SharedField(self._text, poses.call, context, shown=str)
        context.on_choice(self._use, lambda name: COMMANDS[name](poses))
        context.on_choice(save, lambda name: SOURCES[name](poses))

    def show(self) -> None:
        """Update the widgets."""
        names = tuple(pose.name for pose in self._poses.poses)
        if self._list.options != (names or (_NONE,)):
            self._list.options = names or (_NONE,)
        self._use.visible = bool(names)
        self._chosen.show(self._poses.chosen or (names[0] if names else _NONE))
        self._name.show(self._poses.name)
        self._undo.show()
