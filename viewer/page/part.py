"""What every part of the page offers to the thread that runs it."""

from __future__ import annotations


class Part:
    """A part of the page: its widgets and their commands. Runs on the page's thread."""

    def refresh(self) -> bool:
        """Take in changes since the last call; return whether there is anything new to show."""
        return False

    def show(self) -> None:
        """Update widgets and scene; viser sends only what differs."""

    def close(self) -> None:
        """Release what does not belong to the page."""
