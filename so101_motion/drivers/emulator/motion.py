"""Model the servo's motion profile and position loop, in steps of a millisecond.

A *profile* starts at the present position and travels to the goal on a trapezoid of speed; the
*loop* drives the motor after the profile's set-point. Another goal re-plans from the velocity the
profile has at that instant: the speed stays continuous, and a goal behind it is reached by braking
first. The same goal again changes nothing. The profile is blind: it ends on time even if the joint
never moved.

The loop is a P-D-I controller in whole encoder ticks whose output is a duty in thousandths,
plus a constant that overcomes stiction. It has no feed-forward and, as delivered, no integral,
so under gravity the joint hangs below its goal until the error alone makes enough duty.

Positions here are ticks of the unwrapped shaft angle, speeds ticks a second.

Source: Feetech's examples (wait = d / V + V / a), the measurements named in ``joint_figures.py``,
and github.com/0o8o0-blip/sts3215-firmware, motion.c and pid.c (behaviour only).
"""

from __future__ import annotations

import functools
from collections import deque
from dataclasses import dataclass

from so101_motion.drivers.emulator.joint_figures import MAX_DUTY

DT = 0.001
"""The servo's control period [s] (firmware: 1 kHz)."""

SLOWEST = 100.0
"""Slowest profile by unit of register 83 [tick/s]. Measured: unloaded joints never run under
8.8 deg/s (viam-devrel/so-101, one arm); the firmware's arithmetic says 50."""

LEAD = 200.0
"""How far the set-point of a turning servo runs ahead of it, at most [tick]. Chosen: with any gain
that servos are delivered with that is full duty, and one that is held up does not wind up."""


class Profile:
    """The servo's set-point: a trapezoidal profile whose target may change at any time.

    ``speed`` is its cruising speed; it travels at least at ``floor``, from the first step to the
    last.
    """

    __slots__ = ("acceleration", "floor", "position", "speed", "target", "velocity")

    def __init__(self, position: float = 0.0) -> None:
        self.position = self.target = position
        self.velocity = 0.0
        self.acceleration = self.speed = self.floor = 1.0

    def seed(self, position: float) -> None:
        self.position = self.target = position
        self.velocity = 0.0

    @property
    def running(self) -> bool:
        return self.position != self.target or self.velocity != 0.0

    def step(self) -> None:
        distance, velocity = self.target - self.position, self.velocity
        if distance == 0.0 and velocity == 0.0:
            return
        backwards = distance < 0.0
        if backwards:
            distance, velocity = -distance, -velocity
        speed = self._next_speed(velocity, distance)
        # It may only stop from a crawl; a target reached too fast is passed and approached again.
        if speed * DT >= distance and speed <= max(self.floor, self.acceleration * DT):
            self.seed(self.target)
            return
        self.velocity = -speed if backwards else speed
        self.position += self.velocity * DT

    def turn(self, velocity: float, *, around: float) -> None:
        """One step at ``velocity`` [tick/s], at most ``LEAD`` from the servo's position [tick]."""
        change = self.acceleration * DT
        self.velocity += max(min(velocity - self.velocity, change), -change)
        position = self.position + self.velocity * DT
        self.position = self.target = max(min(position, around + LEAD), around - LEAD)

    def _next_speed(self, speed: float, distance: float) -> float:
        change = self.acceleration * DT
        if speed < 0.0:  # going the wrong way: brake before anything else
            return min(speed + change, 0.0)
        cruising, floor = self.speed, self.floor
        if speed > cruising:  # the cruising speed was lowered on the way
            faster = max(speed - change, cruising)
        elif cruising > 0.0:
            faster = speed + change
            if faster > cruising:
                faster = cruising
            if faster < floor:
                faster = floor
        else:
            return speed
        for choice in (faster, speed if speed > floor else floor):
            if choice * (choice / (2.0 * self.acceleration) + DT / 2.0) <= distance:
                return choice  # it can still stop in time
        return max(speed - change, floor)


@dataclass(slots=True, kw_only=True)
class Gains:
    """The loop's registers, as numbers."""

    p: int  # register 21
    d: int  # register 22
    i: int  # register 23
    startup: int  # duty added in the direction of any output
    i_limit: int  # largest share of the integral, 0 for no limit
    cw_dead_zone: int  # errors down to minus this count as none [tick]
    ccw_dead_zone: int  # errors up to this count as none [tick]
    window: int  # how often the D term looks [ms]
    still: int  # changes of the error below this count as none [tick]
    limit: int  # largest output


class Loop:
    """The position controller; output in thousandths of full duty."""

    __slots__ = (
        "_answered", "_change", "_countdown", "_excess", "_last_error", "gains", "integral",
        "output",
    )  # fmt: skip

    def __init__(self, gains: Gains) -> None:
        self.gains = gains
        self.reset()

    def reset(self) -> None:
        self.integral = self.output = 0
        self._excess = self._change = self._last_error = 0
        self._countdown = 1
        self._answered: tuple[int, Gains] | None = None  # the last error, if nothing else counted

    def step(self, error: int, *, integrate: bool) -> int:
        """The demanded duty, -limit..limit, for ``error``, set-point minus position [tick].

        The integral may not grow (``integrate``) while the servo moves or has a fault.
        """
        g = self.gains
        self._countdown -= 1
        asked = (error, g)
        if self._answered == asked and self._countdown > 0:
            return self.output
        self._answered = None if g.i else asked
        if error > g.ccw_dead_zone:
            error -= g.ccw_dead_zone
        elif error < -g.cw_dead_zone:
            error += g.cw_dead_zone
        else:
            error = 0
        if self._countdown <= 0:
            self._countdown = g.window
            change = error - self._last_error
            self._change = 0 if abs(change) < g.still else change
            self._last_error = error
        demand = int(error * g.p / 4)
        if self._change:
            demand += int(self._change * g.d / 8)
        if g.i:
            demand += self._integrate(error if integrate else 0)
        if demand > 0:
            demand += g.startup
        elif demand < 0:
            demand -= g.startup
        limit = g.limit
        output = limit if demand > limit else -limit if demand < -limit else demand
        self.output, self._excess = output, demand - output
        return output

    def _integrate(self, error: int) -> int:
        share = int((self.integral + error) * self.gains.i / 500)
        top = self.gains.i_limit
        # Neither a full output nor a full share may wind the integral up further.
        if error * self._excess <= 0 and (not top or abs(share) <= top or error * share < 0):
            self.integral += error
        share = int(self.integral * self.gains.i / 500)
        return max(min(share, top), -top) if top else share


class GoalDelay:
    """Delays goals by ``delay`` [s], until the control step in which the firmware takes them up.

    ``waiting`` has the goals, and the step in which each is due.
    """

    def __init__(self, delay: float) -> None:
        self._steps = round(delay / DT)
        self._now = 0
        self.waiting: deque[tuple[int, float]] = deque()

    def put(self, goal: float) -> None:
        self.waiting.append((self._now + self._steps, goal))

    def clear(self) -> None:
        self.waiting.clear()

    def step(self) -> float | None:
        """Advance one control period; return the goal that is due. Not needed while none wait."""
        self._now += 1
        goal, waiting = None, self.waiting
        while waiting and waiting[0][0] < self._now:
            goal = waiting.popleft()[1]
        return goal


@functools.cache
def duty_table(shape: float) -> tuple[float, ...]:
    """Duty of the motor by demanded duty in thousandths, 0..1000 and, from the end, -1..-1000."""
    forwards = [min((k / 1000.0) ** shape, MAX_DUTY) for k in range(1001)]
    return (*forwards, *(-duty for duty in reversed(forwards[1:])))
