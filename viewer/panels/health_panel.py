"""The tabs with servo and bus health and the event log; they raise the alarms."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import viser

from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig

from ..page import markup, texts
from ..page.alarms import Alarm, LateCycles, not_said_yet, servo_alarms, state_alarms
from ..page.events import EventLog
from ..page.health import Health, read_health
from ..page.page_context import ArmContext, PageContext
from ..page.part import Part
from ..page.screen_state import Tone

_EVERY = 0.5
"""How often the figures are read anew [s]; nobody reads faster."""

_LINES = 60
"""How many events the page shows; the saved file has all."""


class HealthPart(Part):
    """Shows the figures of the servos and the bus of an arm.

    Args:
        panel: Where the tab is added.
        mark: Called with the joints in alarm, and how bad it is.
        name: What messages call the arm; empty if it is alone.
    """

    def __init__(
        self,
        context: ArmContext,
        panel: viser.PanelHandle,
        *,
        mark: Callable[[Mapping[str, Tone]], None],
        name: str = "",
    ) -> None:
        self._rig: RigLike = context.rig
        self._name = name
        self._bar, self._mark = context.bar, mark
        self._late = LateCycles(
            "this computer" if isinstance(context.rig, Rig) else "the machine's computer"
        )
        self._alarms: tuple[Alarm, ...] = ()
        self._told: tuple[Alarm, ...] = ()
        self._log: EventLog = context.events
        self._due = 0.0
        self._health: Health | None = None
        self._tab = panel.add_tab(f"Health {name}".strip(), viser.Icon.HEARTBEAT)
        with self._tab:
            self._figures = context.gui.add_html("")

    def refresh(self) -> bool:
        """Read the figures now and then; return whether anything changed."""
        now = time.monotonic()
        if now < self._due:
            return False
        self._due = now + _EVERY
        health = read_health(self._rig)
        news = health != self._health
        self._health = health
        self._look_for_alarms(health)
        return news

    def _look_for_alarms(self, health: Health) -> None:
        rig, state = self._rig, self._rig.arm.state
        found: tuple[Alarm, ...] = ()
        if rig.connection.problem is None:
            found = (
                *servo_alarms(health.servos),
                *state_alarms(state, health.uncalibrated, health.not_ready),
                *self._late.alarm(time.monotonic(), health.late_ticks),
            )
        self._tell(not_said_yet(found, state))
        if found != self._alarms:
            self._alarms = found
            self._tab.icon = viser.Icon.ALERT_TRIANGLE if found else viser.Icon.HEARTBEAT
            marks: dict[str, Tone] = {}
            for alarm in found:
                for joint in alarm.joints:
                    if marks.get(joint) is not Tone.BAD:
                        marks[joint] = alarm.sentence.tone
            self._mark(marks)

    def _tell(self, alarms: tuple[Alarm, ...]) -> None:
        """Have the bar say them, and log those whose cause is new."""
        before, self._told = {alarm.cause for alarm in self._told}, alarms
        said = [texts.named(self._name, alarm.sentence) for alarm in alarms]
        for alarm, sentence in zip(alarms, said, strict=True):
            if alarm.cause not in before:
                self._log.add(sentence.text, sentence.tone)
        self._bar.alert(f"alarms {self._name}", said)

    def show(self) -> None:
        """Update the widgets; viser sends only what differs."""
        if self._health is not None:
            self._figures.content = markup.health(self._health)


class EventsPart(Part):
    """Shows the log of events.

    Args:
        panel: Where the tab is added.
    """

    def __init__(self, context: PageContext, panel: viser.PanelHandle) -> None:
        self._log, self._count = context.events, -1
        with panel.add_tab("Events", viser.Icon.LIST):
            self._events = context.gui.add_html("")
            save = context.gui.add_button("Save events", icon=viser.Icon.DOWNLOAD, color="gray")
        context.leave_open(save)
        context.on_asked(save, self._hand_over)

    def refresh(self) -> bool:
        """Return whether there is a new event."""
        return self._count != self._log.count

    def show(self) -> None:
        """Update the widgets; viser sends only what differs."""
        if self._count != self._log.count:
            self._count = self._log.count
            self._events.content = markup.events(self._log.newest(_LINES))

    def _hand_over(self, client: viser.ClientHandle) -> None:
        name = f"so101-events-{time.strftime('%Y%m%d-%H%M%S')}.txt"
        client.send_file_download(name, self._log.text().encode(), save_immediately=True)
