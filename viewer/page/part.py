"""What every part of the page offers to the thread that runs it."""

from __future__ import annotations


class Part:
    """One thing the page can do: some widgets and what they mean. Runs on the page's thread."""

    def refresh(self) -> bool:
        """Look at what happened since the last call; whether there is anything new to show."""
        return False

    def show(self) -> None:
        """Bring widgets and picture up to date; viser sends only what differs."""

    def close(self) -> None:
        """Release what does not belong to the page."""
