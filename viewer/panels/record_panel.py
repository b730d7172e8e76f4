"""The Record tab: episodes for LeRobot; the bar and the tab show when one is being recorded."""

from __future__ import annotations

import viser

from so101_motion.tasks.datasets.episodes import EpisodeOperation

from ..page.operation_panel import OperationPanel
from ..page.page_context import PageContext


class RecordPart(OperationPanel):
    """Shows the operation in a tab of ``panel``; a part behind those that say what the arm does."""

    def __init__(
        self, context: PageContext, operation: EpisodeOperation, panel: viser.PanelHandle
    ) -> None:
        super().__init__(context, lambda: operation)
        self._episodes = operation
        self._tab = panel.add_tab("Record", viser.Icon.MOVIE)
        with self._tab:
            self.build(context.gui)

    def refresh(self) -> bool:
        recorded = self._episodes.recorded
        if recorded is not None:
            self._context.bar.state += f", recording {recorded:.0f} s"
        icon = viser.Icon.MOVIE if recorded is None else viser.Icon.PLAYER_RECORD_FILLED
        if self._tab.icon != icon:
            self._tab.icon = icon
        return super().refresh()
