"""The panel of an operation of one arm, such as picking, and its picture in the scene."""

from __future__ import annotations

from collections.abc import Callable, Collection
from concurrent.futures import Future
from dataclasses import replace

import numpy as np

from so101_motion.common.errors import Interrupted, MachineUnavailable
from so101_motion.common.modes import HELD, Mode
from so101_motion.common.operation import Operation, Picture, View
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig
from so101_motion.viam.client import MachineRig

from ..page import texts
from ..page.operation_panel import OperationPanel
from ..page.page_context import PageContext, Part
from ..page.screen_state import Sentence, Tone
from ..scene.robot_view import Color, Line, SweepView, segments

_NEVER_BLOCKED = ("stop", "end", "delete_path", "restore_path")


class TaskPart(Part):
    """Shows an operation of the arm in the tab that the caller has opened.

    Args:
        name: The operation's name on a machine.
        moves: Those of its commands that move the arm.
        here: Makes the operation of an arm of this computer.
        cannot: What to say of a machine whose module does not have it.
        node: The scene node to draw under.
        tab: The tab that must be in front for it to be drawn.
    """

    def __init__(
        self,
        context: PageContext,
        rig: RigLike,
        name: str,
        moves: Collection[str],
        here: Callable[[Rig], Operation],
        *,
        cannot: str,
        node: str,
        tab: str,
        color: Color,
    ) -> None:
        self._context, self._rig, self._tab = context, rig, tab
        self._name, self._moves, self._here = name, moves, here
        self._color = color
        self._line = Line(context.server.scene, f"{node}/path")
        self._ghosts = SweepView(context.server.scene, f"{node}/ghosts", color=color)
        self._drawn: Picture | None = None
        self._opening = self._open()
        self._was_impossible = False
        self._blocked: Sentence | None = None
        self._panels: list[OperationPanel] = []
        self._cannot = Sentence(cannot, Tone.WARM)
        self._head = context.gui.add_html("", visible=False)
        self.add(self._operation, draw=self._draw)

    def add(
        self,
        operation: Callable[[], Operation | None],
        draw: Callable[[View], None] = lambda _view: None,
    ) -> None:
        """Show one more operation of this arm, and close it with this part."""
        panel = OperationPanel(
            self._context, operation, draw=draw, as_shown=self._as_shown, rows_last=True
        )
        panel.build(self._context.gui)
        self._panels.append(panel)

    def _open(self) -> Future[Operation]:
        rig = self._rig
        if isinstance(rig, MachineRig):
            return self._context.in_background(lambda: rig.operation(self._name, self._moves))
        assert isinstance(rig, Rig)
        local: Future[Operation] = Future()
        local.set_result(self._here(rig))
        return local

    def _operation(self) -> Operation | None:
        opening = self._opening
        if not opening.done():
            return None
        error = opening.exception()
        if isinstance(error, MachineUnavailable):
            self._opening = self._open()
        return None if error is not None else opening.result()

    @property
    def _is_impossible(self) -> bool:
        return self._opening.done() and self._opening.exception() is not None

    def refresh(self) -> bool:
        state = self._rig.arm.state
        before, self._blocked = self._blocked, None
        if state.mode not in (Mode.LIMP, Mode.GUIDING):  # by hand it can be taught even so
            self._blocked = texts.blocked(state)
        if self._blocked is not None or state.mode not in HELD:
            for panel in self._panels:  # what is said here, or that it was stopped and holds
                panel.forget_trouble(Exception if self._blocked is not None else Interrupted)
        was_impossible, self._was_impossible = self._was_impossible, self._is_impossible
        have_news = [panel.refresh() for panel in self._panels]
        is_news = (before, was_impossible) != (self._blocked, self._was_impossible)
        return any(have_news) or is_news

    def show(self) -> None:
        lost = self._context.bar.lost
        self._head.visible = self._is_impossible or (lost or self._blocked) is not None
        self._head.content = self._context.sentence(self._blocked or self._cannot)
        for panel in self._panels:
            panel.show()

    def _as_shown(self, view: View) -> View:
        """While something blocks the arm: without what it forbids; the head says why."""
        if self._blocked is None:
            return view
        offers = (
            offer if offer.command in _NEVER_BLOCKED else replace(offer, why_not="")
            for offer in view.offers
        )
        return replace(view, text="", trouble="", offers=tuple(offers))

    def _draw(self, view: View) -> None:
        is_front = self._context.front.name == self._tab
        picture = view.picture if view.picture is not None and is_front else Picture()
        if picture == self._drawn:
            return
        self._drawn = picture
        line = segments(np.array(picture.line)) if len(picture.line) > 1 else None
        self._line.show(line, self._color)
        ghosts = np.array(picture.ghosts).reshape(-1, 6)
        q_jaw = float(ghosts[0, 5]) if len(ghosts) else 0.0
        self._ghosts.show(ghosts[:, :5] if len(ghosts) else None, q_jaw, self._rig.arm.model)

    def close(self) -> None:
        for panel in reversed(self._panels):
            panel.close()
