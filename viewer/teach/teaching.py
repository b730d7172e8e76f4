"""What the Teach tab needs from a model that records and replays paths.

``path_teaching.py`` does it for an arm on this computer, ``machine_teaching.py`` for that of a
machine.
"""

from __future__ import annotations

from enum import Enum
from typing import Protocol

from so101_motion.common.geometry import Array

from ..page.screen_state import Sentence, Tone
from ..page.shared_fields import CanUndo

WELCOME = Sentence(text="Press Record a path, then guide the arm by hand.")
STANDS = Sentence(
    text="A simulated arm cannot be guided by hand: what you record stands still. Load a path to"
    " replay it."
)
"""For a simulated arm."""
BEGINS = Sentence(text="Switching to manual mode …", tone=Tone.WARM)
PLANNING = Sentence(text="Planning the replay …")
PLAN = Sentence(text="Press Plan replay to check it for collisions; nothing moves.")
ARM_MOVED = Sentence(text="The arm has moved. Press Plan replay again.")
DONE = Sentence(text="Done. Press Plan replay to run it again.", tone=Tone.GOOD)


class Doing(Enum):
    """What the teaching is doing."""

    NOTHING = "nothing"
    BEGINNING = "beginning"
    RECORDING = "recording"
    ENDING = "ending"
    PLANNING = "planning"
    REPLAYING = "replaying"


class Teaching(Protocol):
    """Records, keeps, plans and replays one path at a time. One thread owns it."""

    @property
    def doing(self) -> Doing:
        """What is going on."""

    @property
    def sentence(self) -> Sentence:
        """What to know or to do now."""

    @property
    def line(self) -> Array | None:
        """Where the tool is along the path, (m, 3) in the base frame [m]; None if not known."""

    @property
    def name(self) -> str:
        """What a path is or will be called."""

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the saved paths."""

    @property
    def saved_files(self) -> CanUndo:
        """Undoes what was done to the saved paths."""

    @property
    def can_record(self) -> bool:
        """Whether the arm may be led by hand now."""

    @property
    def can_plan(self) -> bool:
        """Whether a replay can be planned now."""

    @property
    def can_run(self) -> bool:
        """Whether the plan can be run now."""

    def record(self) -> None:
        """Let the arm yield to a hand, and record its path."""

    def end_recording(self) -> None:
        """End the recording; the arm holds where it is."""

    def plan(self) -> None:
        """Plan the replay; nothing moves."""

    def run(self) -> None:
        """Move along the path."""

    def call(self, name: str) -> None:
        """Set the name of a path."""

    def load(self, name: str) -> None:
        """Take a saved path; nothing moves."""

    def delete(self, name: str) -> None:
        """Delete a saved path."""

    def report(self, error: BaseException) -> None:
        """Show that a command failed."""

    def refresh(self) -> None:
        """Take in what has happened since the last call."""


def planned(approach: float, along: float) -> Sentence:
    """A replay is planned, with its durations to the beginning of the path and along it [s]."""
    text = f"Planned: {approach:.1f} s to its start, then {along:.1f} s along it. Press Replay."
    return Sentence(text=text, tone=Tone.GOOD)


def holds_again(left: float | None) -> str:
    """When the arm holds by itself, after a recording's sentence; nothing for no limit [s]."""
    return "" if left is None else f" It holds again in {max(left, 0.0):.0f} s."
