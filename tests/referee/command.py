"""The command ``q_cmd`` itself: speed, acceleration and jerk, exactly.

The record holds every command with its time. On simulated time the cycles are exact, so differences
of neighbouring commands are averages of what the command did in between and must keep its caps to
the last digit. A command that was repeated later stood still meanwhile.

A command may leave its path in one case: it goes to where the joint truly is, because the joint was
held, pushed or out of reach. That moves nothing.
"""

from dataclasses import dataclass

EXACT = 1.0 + 1e-6
ROUNDING = 1e-4  # [deg] of a command; over one cycle of 10 ms that is 0.01 deg/s
AT_JOINT = 0.5  # [deg]
TICK = 360.0 / 4096.0
STOP_JERK = 1.02  # share of its jerk cap that a stop along a path promises to keep


@dataclass(frozen=True)
class CommandCaps:
    """[deg/s], [deg/s^2], [deg/s^3]; ``braking`` holds while a joint slows down."""

    speed: float
    acceleration: float
    jerk: float
    braking: float = 600.0


class Command:
    """Judges the commands of one joint; ``report`` takes rule, time and text of a finding."""

    def __init__(self, report, dt=0.01):
        self._report, self._dt = report, dt
        self._last = []  # newest four angles, a period apart
        self._t = None
        self._blind = 0
        self._news = None

    def rest(self, t, q):
        """The command is ``q`` [deg] and has been for long, whatever it was before."""
        self._last, self._t = [q] * 4, t
        self._blind, self._news = 0, None

    def forget(self):
        """What comes next has nothing to do with what was; it may be in motion."""
        self._t = None

    def sent(self, t, q, caps, off_joint):
        """The joint was commanded to ``q`` [deg]; it truly is ``off_joint`` away [deg].

        It is judged when the next one comes: only the last command of a cycle counts.
        """
        if self._t is None:
            self.rest(t, q)
            self._blind = len(self._last)
            return
        gap = t - self._t
        if gap < 0.5 * self._dt:
            self._last[-1], self._news = q, (t, caps, off_joint)
            return
        self._judge()
        if gap > 3.5 * self._dt:
            self._last = [self._last[-1]] * 4
        for _ in range(min(round(gap / self._dt), 3) - 1):
            self._last = [*self._last[1:], self._last[-1]]
        self._last, self._t = [*self._last[1:], q], t
        self._news = t, caps, off_joint

    def _judge(self):
        if self._news is None:
            return
        t, caps, off_joint = self._news
        self._news = None
        self._blind = max(self._blind - 1, 0)
        problem = self._problem(caps)
        if problem is None or self._blind:
            return
        self._blind = len(self._last)  # what follows is no news
        if abs(off_joint) > AT_JOINT + caps.speed * self._dt:  # it was looked at a cycle ago
            self._report(
                "command", t, f"{problem}; the joint is {abs(off_joint):.2f} deg from there"
            )

    def _problem(self, caps):
        """What these four commands break, None if they break nothing."""
        q0, q1, q2, q3 = self._last
        dt = self._dt
        v1, v2, v3 = (q1 - q0) / dt, (q2 - q1) / dt, (q3 - q2) / dt
        a2, a3 = (v2 - v1) / dt, (v3 - v2) / dt
        jerk = (a3 - a2) / dt
        slowing = abs(v3) < abs(v2)
        most = max(caps.braking, caps.acceleration) if slowing else caps.acceleration
        for name, value, cap, unit, order in (
            ("speed", v3, caps.speed, "deg/s", 1),
            ("acceleration", a3, most, "deg/s^2", 2),
            ("jerk", jerk, caps.jerk, "deg/s^3", 3),
        ):
            if abs(value) > cap * EXACT + ROUNDING * 2 ** (order - 1) / dt**order * 1e-2:
                return f"{name} {value:.6g} {unit} of {cap:.6g} allowed"
        return None
