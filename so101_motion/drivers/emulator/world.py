"""Simulate the six servos of an arm over time, with gravity, hand and supply.

Nothing runs by itself. A caller that reads or changes the servos calls ``advance`` with the time
first. The world then catches up in steps of 1 ms, and every 5 ms updates gravity, the hand, the
things around the arm, the supply, heat and protections. Servos that are quiet (see ``drive.py``)
are not stepped, and when all are quiet, the rest of the interval is one jump: an arm at rest costs
nothing.

The joints do not move each other: each has one inertia. Gravity and the supply couple them.

Every public method takes ``lock``, so a test may disturb the servos while another thread serves
their port; hold it yourself to do several things at once.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence

import numpy as np

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.drivers.emulator.electric import ROOM_C, Supply
from so101_motion.drivers.emulator.hand import OBJECT_STIFFNESS, Hand, jaw_angle_for_gap
from so101_motion.drivers.emulator.joint_figures import TICKS_PER_RAD
from so101_motion.drivers.emulator.mechanics import STOP_STIFFNESS
from so101_motion.drivers.emulator.servo import Servo
from so101_motion.drivers.things import Things

Gravity = Callable[[Array], Array]
"""Torque [N m] the six joints must exert to hold still at joint angles ``q`` [rad], shapes (6,):
the generalised gravity of rigid-body dynamics. The arm feels its negative. It is called by the
thread that advances the world, mostly the port's, and by one thread at a time."""

_SLOW_MS = 5
_JUMP_MS = 1000  # longest jump while everything rests
_TIMING_JUMP_MS = 50  # while a protection timer or a start-up runs


def no_gravity(q: Array) -> Array:
    return np.zeros_like(q)


class World:
    """The servos along the cable, base to gripper, with the torques on them and their supply.

    It starts at ``t`` [s]. The ``supply``'s voltage may be changed at any time, and ``hand`` be
    replaced to start another script; ``things`` are what the jaw can meet. ``lock``, re-entrant, is
    held while anything changes.
    """

    def __init__(
        self,
        servos: Sequence[Servo],
        *,
        t: float = 0.0,
        gravity: Gravity = no_gravity,
        supply: Supply,
        things: Things | None = None,
    ) -> None:
        self.servos = tuple(servos)
        self.supply = supply
        self.hand = Hand()
        self.things = things
        self._jaw_stop = -math.inf
        self.lock = threading.RLock()
        self._gravity = gravity
        self._origin, self._ms, self._phase = t, 0, 0
        self._felt: list[float] = []  # angles the gravity was last computed for
        self._weights = [0.0] * len(self.servos)
        self._look(0.0)

    @property
    def t(self) -> float:
        """The time up to which everything has been computed [s]."""
        return self._origin + self._ms / 1000.0

    @property
    def q(self) -> Array:
        """True joint angles, shape (6,), [rad]."""
        return np.array([servo.drive.q for servo in self.servos])

    @property
    def gravity(self) -> Gravity:
        """The torque that holds the joints; another once something was put into the jaws."""
        return self._gravity

    @gravity.setter
    def gravity(self, gravity: Gravity) -> None:
        with self.lock:
            self._gravity, self._felt = gravity, []

    def servo(self, place: str | int) -> Servo:
        """A servo by joint name or place on the cable, 1 to 6; ``ConfigError`` if there is none."""
        for number, servo in enumerate(self.servos, start=1):
            if place in (servo.joint.name, number, str(number)):
                return servo
        known = ", ".join(servo.joint.name for servo in self.servos)
        raise ConfigError("servo", place, f"must be 1 to {len(self.servos)} or one of {known}")

    # -- time -----------------------------------------------------------------------------------

    def advance(self, now: float) -> None:
        """Catch up with the clock; a clock that went back changes nothing."""
        due = int((now - self._origin) * 1000.0 + 1e-6)
        with self.lock:
            while self._ms < due:
                self._pass(self._run(due - self._ms))

    def _run(self, left: int) -> int:
        """Step the moving servos, at most to the next slow update; return the milliseconds."""
        awake = [servo.drive for servo in self.servos if not servo.drive.quiet]
        if not awake and not self.hand.busy and not self._phase:
            soon = any(each.drive.guard.timing or each.boot_at is not None for each in self.servos)
            return min(_TIMING_JUMP_MS if soon else _JUMP_MS, left)
        span = min(_SLOW_MS - self._phase, left)
        for drive in awake:
            drive.run(span)
        return span

    def _pass(self, span: int) -> None:
        self._ms += span
        elapsed = self._phase + span
        self._phase = elapsed % _SLOW_MS
        if elapsed >= _SLOW_MS:
            self._look((elapsed - self._phase) / 1000.0)

    def _look(self, dt: float) -> None:
        """Update gravity, hand, supply, heat and protections after ``dt`` seconds."""
        now, hand = self.t, self.hand if self.hand.busy else None
        volts = self.supply.under(servo.drive.motor.drawn for servo in self.servos)
        angles = [servo.drive.q for servo in self.servos]
        if angles != self._felt:
            self._felt, self._weights = angles, self._gravity(np.array(angles)).tolist()
        weights = self._weights
        if self.things is not None:
            carried = self._meet(self.things, np.array(angles))
            weights = [a + b for a, b in zip(weights, carried, strict=True)]
        for servo, weight in zip(self.servos, weights, strict=True):
            drive, direction = servo.drive, servo.joint.direction
            push = 0.0
            if hand is not None:
                qd = direction * drive.shaft.velocity / TICKS_PER_RAD
                push = hand.torque(servo.joint.name, now, drive.q, qd)
            load = direction * (push - weight)
            if abs(load - drive.load) > 1e-4 or abs(volts - drive.volts) > 0.02:
                drive.load, drive.volts = load, volts
                drive.wake()
            if dt:
                drive.slow_step(dt)
            servo.follow_power(now)

    def _meet(self, things: Things, q: Array) -> list[float]:
        """Let things stop the jaw, and the jaw take them along; the torques that carry one."""
        pressed = max(self._jaw_stop - float(q[5]), 0.0)
        stop = things.follow(q, OBJECT_STIFFNESS * pressed)
        if stop != self._jaw_stop:
            self._jaw_stop = stop
            self.put_wall("gripper", stop, math.inf, OBJECT_STIFFNESS)
        return list(things.weight(q))

    # -- what people do to an arm ---------------------------------------------------------------

    def connect(self, place: str | int) -> None:
        with self.lock:
            self.servo(place).connected = True
            self._react()

    def disconnect(self, place: str | int) -> None:
        """Unplug a servo; it becomes silent and limp, like a dead one."""
        with self.lock:
            self.servo(place).connected = False
            self._react()

    def reboot(self, place: str | int) -> None:
        """Reset a servo, as after a spike on its supply."""
        with self.lock:
            servo = self.servo(place)
            servo.power_off()
            self._react()

    def power(self, volts: float) -> None:
        """Set the supply voltage [V]; 0 is off, 5 is weak."""
        with self.lock:
            self.supply.volts = volts
            self._react()

    def warm(self, place: str | int, celsius: float) -> None:
        with self.lock:
            motor = self.servo(place).drive.motor
            motor.temperature = motor.ambient = celsius
            self._react()

    def cool(self, place: str | int) -> None:
        with self.lock:
            self.servo(place).drive.motor.ambient = ROOM_C

    def put_object(self, width: float, stiffness: float = OBJECT_STIFFNESS) -> None:
        """Hold something ``width`` [m] wide, ``stiffness`` [N m/rad at the jaw], in the jaws."""
        self.put_wall("gripper", jaw_angle_for_gap(width), math.inf, stiffness)

    def take_object(self) -> None:
        self.put_wall("gripper", -math.inf, math.inf)

    def put_wall(
        self, place: str | int, lower: float, upper: float, stiffness: float = STOP_STIFFNESS
    ) -> None:
        """Put obstacles in a joint's travel at these angles [rad]; its own stops stay.

        ``stiffness`` is theirs [N m/rad].
        """
        with self.lock:
            servo = self.servo(place)
            drive, joint = servo.drive, servo.joint
            walls = [
                (drive.to_ticks(max(lower, joint.lower)), lower > joint.lower),
                (drive.to_ticks(min(upper, joint.upper)), upper < joint.upper),
            ]
            (drive.shaft.lower, low), (drive.shaft.upper, high) = sorted(walls)
            drive.shaft.lower_stiffness = stiffness if low else STOP_STIFFNESS
            drive.shaft.upper_stiffness = stiffness if high else STOP_STIFFNESS
            drive.wake()

    def _react(self) -> None:
        self._look(0.0)
        for servo in self.servos:
            servo.drive.wake()
