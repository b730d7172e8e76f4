"""The content of the bar at the top of the page, which our own front end shows.

The browser gets it as JSON in an invisible piece of HTML, and presses the buttons by the ids of
invisible widgets (``server/front/bar.js``).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import viser

from .screen_state import Sentence, Tone

CONNECTION = "connection"
"""The source of what is wrong with the connection or the mode of an arm; it is said first."""


@dataclass(slots=True, kw_only=True)
class BarButton:
    """A button of the bar."""

    label: str
    button: viser.GuiButtonHandle  # the invisible widget that is pressed
    # why it cannot be pressed now, as a sentence; None if it can
    why_not: str | None = "Looking for the arm."
    asks: str | None = None  # what it asks before it does anything; None if it does not ask


class Bar:
    """The content of the bar. For the page's thread.

    Attributes:
        stop: The widget that Stop presses; None until there is something to stop.
        plan: The widget that the key P presses, or None.
        lost: What every tab says instead of its own sentence while an arm is not there or not yet
            held again; None if all are.
        views: Labels and widgets of the buttons over the picture, which turn the camera.
    """

    def __init__(self) -> None:
        self.state = self.title = ""
        self.buttons: tuple[BarButton, ...] = ()
        self.stop: viser.GuiButtonHandle | None = None
        self.plan: viser.GuiButtonHandle | None = None
        self.lost: Sentence | None = None
        self.views: tuple[tuple[str, viser.GuiButtonHandle], ...] = ()
        self._alerts: dict[str, tuple[Sentence, ...]] = {CONNECTION: ()}

    def alert(self, source: str, sentences: Iterable[Sentence] = ()) -> None:
        self._alerts[source] = tuple(sentences)

    @property
    def alerts(self) -> list[Sentence]:
        """What is wrong, the worst first."""
        said = [each for sentences in self._alerts.values() for each in sentences]
        return sorted(said, key=lambda each: each.tone is not Tone.BAD)

    def text(self) -> str:
        alerts = [{"tone": each.tone.value, "text": each.text} for each in self.alerts]
        return board(
            "bar",
            state=self.state,
            title=self.title,
            stop=uuid_of(self.stop),
            plan=uuid_of(self.plan),
            alerts=alerts,
            views=[{"label": label, "press": uuid_of(button)} for label, button in self.views],
            buttons=[
                {
                    "label": each.label,
                    "press": uuid_of(each.button),
                    "why_not": each.why_not,
                    "asks": each.asks,
                }
                for each in self.buttons
            ],
        )


def board(name: str, **content: Any) -> str:
    """The content of an invisible piece of HTML that tells our front end something, as JSON."""
    return json.dumps({"so101": name, **content}, separators=(",", ":"))


def uuid_of(widget: Any) -> str | None:
    """The id by which a browser presses ``widget``."""
    return None if widget is None else str(widget._impl.uuid)


def greyed(group: Any, why_not: Mapping[str, str]) -> str:
    """A board that greys single buttons of a row, with why; a press just then must be harmless."""
    return board(f"row {uuid_of(group)}", row=uuid_of(group), why_not=why_not)


def add_stop(gui: viser.GuiApi, *stops: Callable[[], None]) -> viser.GuiButtonHandle:
    """Add the invisible button that the bar's Stop and the keys Space and Escape press.

    It calls each of ``stops`` in a thread of its own, because it may wait for rest.
    """
    button = gui.add_button("STOP", color="red", visible=False)
    for stop in stops:

        def pressed(_event: object, stop: Callable[[], None] = stop) -> None:
            stop()

        button.on_click(pressed)
    return button
