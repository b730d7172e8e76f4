"""The panel under Stop: servo and bus health, and the event log.

It is a panel of its own so that nothing in it can take a click away from Stop.
"""

from __future__ import annotations

import time

import viser

from so101_motion.rig.protocols import RigLike

from ..page import markup
from ..page.events import EventLog
from ..page.health import Health, read_health
from ..page.page_context import ArmContext
from ..page.part import Part

_EVERY = 0.5
"""How often the figures are read anew [s]; nobody reads faster."""

_LINES = 60
"""Events on the page; a file has them all."""


class HealthPart(Part):
    """Shows the figures of servos and bus, and the log."""

    def __init__(self, context: ArmContext) -> None:
        self._rig: RigLike = context.rig
        self._log: EventLog = context.events
        self._due, self._count = 0.0, -1
        self._health: Health | None = None
        panel = context.gui.add_panel()
        with panel.add_tab("Health", viser.Icon.HEARTBEAT):
            self._figures = context.gui.add_html("")
        with panel.add_tab("Events", viser.Icon.LIST):
            self._events = context.gui.add_html("")
            save = context.gui.add_button("Save events", icon=viser.Icon.DOWNLOAD, color="gray")
        context.leave_open(save)
        context.on_asked(save, self._hand_over)
        self.panel = panel

    def refresh(self) -> bool:
        """Read the figures now and then; return whether anything changed."""
        now = time.monotonic()
        news = self._count != self._log.count
        if now >= self._due:
            self._due = now + _EVERY
            health = read_health(self._rig)
            news = news or health != self._health
            self._health = health
        return news

    def show(self) -> None:
        """Update the widgets; viser sends only what differs."""
        if self._health is not None:
            self._figures.content = markup.health(self._health)
        if self._count != self._log.count:
            self._count = self._log.count
            self._events.content = markup.events(self._log.newest(_LINES))

    def _hand_over(self, client: viser.ClientHandle) -> None:
        name = f"so101-events-{time.strftime('%Y%m%d-%H%M%S')}.txt"
        client.send_file_download(name, self._log.text().encode(), save_immediately=True)
