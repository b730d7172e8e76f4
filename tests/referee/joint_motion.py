"""How one joint truly moves, smoothed over 50 ms.

It is measured on the motor's side of the gears: through their play a joint falls whatever its
goal.
"""

from collections import deque

from referee.wire import is_held_up

TICK = 360.0 / 4096.0
SMOOTH = 0.05  # [s]
SHARE = 1.2
AHEAD = 240.0  # [deg/s^2]
"""How much harder than its share of the cap a joint may brake: goals are sent ahead of the command,
so at the end of a fast motion the servo brakes by itself, and its own cap is 1,000. Seen: 887 where
the hardest stop is 600, of a follower at 180 deg/s on a bus that loses answers."""
CALM = 0.5  # [s], how long after a force from outside or a fault has gone nothing is judged


class JointMotion:
    """The motion of one joint.

    Args:
        servo: The emulated servo.
        report: Takes rule, time and text of a finding.
    """

    def __init__(self, servo, report):
        self._servo, self._report = servo, report
        self._samples = deque()  # time, angle [deg]
        self._speeds = deque()  # time, smoothed speed
        self._free_since = None

    def look(self, t, caps, pushed):
        """See where it is at ``t``."""
        drive = self._servo.drive
        is_driven = drive.powered and drive.torque == 1
        undisturbed = is_driven and not pushed and not is_held_up(self._servo)
        if not undisturbed:
            self._free_since = None
            self._samples.clear()
            self._speeds.clear()
            return
        if self._free_since is None:
            self._free_since = t
        if t - self._free_since < CALM:
            return
        if self._samples and t <= self._samples[-1][0]:
            return
        if self._samples and t - self._samples[-1][0] > SMOOTH:  # nobody wrote, so nobody looked
            self._samples.clear()
            self._speeds.clear()
        self._samples.append((t, drive.shaft.rotor * TICK))
        speed = _slope(self._samples, t)
        if speed is None:
            return
        self._speeds.append((t, speed))
        acceleration = _slope(self._speeds, t)
        self._judge(t, speed, acceleration, caps)

    def _judge(self, t, speed, acceleration, caps):
        most = SHARE * caps.speed
        if abs(speed) > most:
            self._report("motion", t, f"{speed:.1f} deg/s, {most:.1f} allowed")
        if acceleration is None:
            return
        most = SHARE * caps.acceleration + AHEAD
        if abs(acceleration) > most:
            self._report("motion", t, f"{acceleration:.0f} deg/s^2, {most:.0f} allowed")


def _slope(samples, t):
    """Change over the last 50 ms, per second; None while less is known. Drops what is older."""
    edge = t - SMOOTH
    while len(samples) > 1 and samples[1][0] <= edge + 1e-9:
        samples.popleft()
    (t0, x0), (t1, x1) = samples[0], samples[1 if len(samples) > 1 else 0]
    if t0 > edge + 1e-9 or t1 == t0:
        return None
    share = (edge - t0) / (t1 - t0)
    return (samples[-1][1] - (x0 + (x1 - x0) * share)) / SMOOTH
