"""The folder with the user's own poses, in the Move tab."""

from __future__ import annotations

from .desk import Desk
from .fields import Field
from .poses import COMMANDS, SOURCES, PoseShelf

_NONE = "none saved yet"


class PoseFolder:
    """Widgets on a shelf of poses.

    Args:
        desk: Where to make them.
        shelf: What they act on.
    """

    def __init__(self, desk: Desk, shelf: PoseShelf) -> None:
        self._shelf = shelf
        gui = desk.gui
        with gui.add_folder("My poses", expand_by_default=False):
            self._list = gui.add_dropdown("Pose", (_NONE,))
            self._use = gui.add_button_group("Use it", tuple(COMMANDS))
            self._text = gui.add_text("Name", "")
            save = gui.add_button_group(
                "Save", tuple(SOURCES), hint="Where the arm is, or where the ghost is"
            )
        self._chosen = Field(self._list, shelf.choose, desk, shown=str)
        self._name = Field(self._text, shelf.call, desk, shown=str)
        desk.on_choice(self._use, lambda name: COMMANDS[name](shelf))
        desk.on_choice(save, lambda name: SOURCES[name](shelf))

    def show(self) -> None:
        """Bring it up to date."""
        names = tuple(pose.name for pose in self._shelf.poses)
        if self._list.options != (names or (_NONE,)):
            self._list.options = names or (_NONE,)
        self._use.visible = bool(names)
        self._chosen.show(self._shelf.chosen or (names[0] if names else _NONE))
        self._name.show(self._shelf.name)
