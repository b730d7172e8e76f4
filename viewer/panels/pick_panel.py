"""The Pick tab: pick an item of the scene and put it somewhere, with ghosts of all stages."""

from __future__ import annotations

from concurrent.futures import Future
from functools import partial

import numpy as np

from so101_motion.common.operation import Operation, View
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig
from so101_motion.tasks.picking import PickOperation
from so101_motion.viam.client import MachineRig

from ..page.operation_panel import OperationPanel
from ..page.page_context import PageContext, Part
from ..scene.robot_view import Line, SweepView, segments

_COLOR = (140, 95, 200)


class PickPart(Part):
    """The widgets of the Pick tab; ``place`` is proposed."""

    def __init__(
        self,
        context: PageContext,
        rig: RigLike,
        place: str = "",
        *,
        title: str = "Pick",
        node: str = "",
    ) -> None:
        self._rig = rig
        self._line = Line(context.server.scene, f"{node}/pick/path")
        self._ghosts = SweepView(context.server.scene, f"{node}/pick/ghosts", color=_COLOR)
        self._drawn: object = None
        self._opening: Future[Operation] | None = None
        if isinstance(rig, MachineRig):
            moves = ("pick", "place", "run")
            self._opening = context.in_background(partial(rig.operation, "picking", moves))
        elif isinstance(rig, Rig):
            self._opening = Future()
            self._opening.set_result(PickOperation(rig.picker, place))
        self._panel = OperationPanel(context, self._operation, draw=self._draw)
        with context.tabs.add_tab(title):
            self._panel.build(context.gui)

    def _operation(self) -> Operation | None:
        opening = self._opening
        if opening is None or not opening.done() or opening.exception() is not None:
            return None
        return opening.result()

    def refresh(self) -> bool:
        return self._panel.refresh()

    def show(self) -> None:
        self._panel.show()

    def _draw(self, view: View) -> None:
        picture = view.picture
        if picture == self._drawn:
            return
        self._drawn = picture
        line = np.array(picture.line) if picture is not None and len(picture.line) > 1 else None
        self._line.show(None if line is None else segments(line), _COLOR)
        ghosts = np.array(picture.ghosts) if picture is not None and picture.ghosts else None
        model = self._rig.arm.model
        if ghosts is None:
            self._ghosts.show(None, 0.0, model)
        else:
            self._ghosts.show(ghosts[:, :5], float(ghosts[0, 5]), model)

    def close(self) -> None:
        self._panel.close()
