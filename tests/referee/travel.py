"""How far something may move in a given time, checked over every window at once."""

from collections import deque


class Travel:
    """Judges a value that is set now and then and kept in between.

    Over any window of ``window`` seconds or more it may go at most ``speed`` times its length, and
    ``slack`` beyond. Each value is compared with all earlier ones in constant time: what goes up
    at ``speed`` at most keeps ``value - speed * t`` from growing.
    """

    def __init__(self, window, slack):
        self._window, self._slack = window, slack
        self._speed = 0.0
        self.restart()

    def restart(self):
        """What comes next has nothing to do with what was."""
        self._recent = deque()
        self._held = None
        self._low, self._high = float("inf"), -float("inf")

    def excess(self, t, value, speed, extra=0.0):
        """Take in a value; by how much it breaks the rule; negative if it does not.

        Args:
            t: When, [s]; never less than before.
            value: What it is from now on.
            speed: How fast it may go; a change starts the comparison anew.
            extra: More slack for this one.
        """
        if speed != self._speed:
            kept = self._recent[-1] if self._recent else None
            self.restart()
            self._speed = speed
            if kept is not None:
                self._recent.append((t, kept[1]))
        edge = t - self._window
        while self._recent and self._recent[0][0] <= edge:
            since, self._held = self._recent.popleft()
            until = self._recent[0][0] if self._recent else edge
            self._reach(since, self._held)
            self._reach(min(until, edge), self._held)
        if self._held is not None:
            self._reach(edge, self._held)
        up = value - speed * t - self._low
        down = self._high - (value + speed * t)
        self._recent.append((t, value))
        return max(up - self._slack - extra, down - self._slack - extra)

    def _reach(self, t, value):
        self._low = min(self._low, value - self._speed * t)
        self._high = max(self._high, value + self._speed * t)
