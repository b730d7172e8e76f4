"""How one joint truly moves, smoothed over 50 ms.

It is measured on the motor's side of the gears: through their play a joint falls whatever its
goal.

A motor that crosses its play moves nothing yet, and nothing tells its servo that it runs: the
encoder sits behind the gears. So it may accelerate harder than one that carries its joint, by as
much as the servo does by itself. Its set-point accelerates at ``a``, so its error grows with the
way of that, ``a t^2 / 2``. A free motor turns ``h`` times as fast as its error is large, which
makes ``h a t^2 / 2`` and a way of ``h a t^3 / 6``. That is the whole play ``p`` after
``(6 p / h a)^(1/3)``, and by then the motor accelerates by ``h a t = (6 p h^2 a^2)^(1/3)``: 1,130
deg/s^2 of a pan at 12 V and a P gain of 32.
"""

import math
from collections import deque

from referee.wire import is_held_up

TICK = 360.0 / 4096.0
SMOOTH = 0.05  # [s]
SHARE = 1.2
AHEAD = 240.0  # [deg/s^2]
"""How much harder than its share of the cap a joint may brake: goals are sent ahead of the command,
so at the end of a fast motion the servo brakes by itself, and its own cap is 1,000. Seen: 887 where
the hardest stop is 600, of a follower at 180 deg/s on a bus that loses answers."""
EDGE = 0.05  # [tick], as near to its edge a motor is not in its play
CALM = 0.5  # [s], how long after a force from outside or a fault has gone nothing is judged


class JointMotion:
    """The motion of one joint; ``report`` takes rule, time and text of a finding."""

    def __init__(self, servo, report):
        self._servo, self._report = servo, report
        self._samples = deque()  # time, angle [deg]
        self._speeds = deque()  # time, smoothed speed
        self._free_since = None
        self._side = 0.0  # of the play, on which the joint is; 0 inside
        self._crossed = -math.inf

    def look(self, t, caps, pushed):
        """See where it is at ``t``."""
        drive = self._servo.drive
        self._find_side(t)
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
        if t - self._crossed <= 2.0 * SMOOTH + 1e-9:  # what the two slopes are of
            most = max(most, self._free_motor(SHARE * caps.acceleration))
        if abs(acceleration) > most:
            self._report("motion", t, f"{acceleration:.0f} deg/s^2, {most:.0f} allowed")

    def _find_side(self, t):
        """Note whether the motor is in its play, or has crossed it since the last look."""
        shaft = self._servo.drive.shaft
        off = shaft.output - shaft.rotor
        is_inside = abs(off) < 0.5 * self._play - EDGE
        side = 0.0 if is_inside else math.copysign(1.0, off)
        if is_inside or side != self._side:
            self._crossed = t
        self._side = side

    def _free_motor(self, acceleration):
        """How hard the motor may accelerate through its play [deg/s^2], as its set-point does."""
        drive = self._servo.drive
        set_point = min(acceleration, drive.profile.acceleration * TICK)
        full_speed = drive.volts / drive.motor.kind.back_emf * 180.0 / math.pi  # [deg/s]
        share = drive.settings.gains.p / 4000.0 / TICK  # of full drive, for a degree of error
        return (6.0 * self._play * TICK * (full_speed * share * set_point) ** 2) ** (1.0 / 3.0)

    @property
    def _play(self):
        return self._servo.drive.motor.kind.play * 2048.0 / math.pi  # [tick]


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
