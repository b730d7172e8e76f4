"""The simulated arm: six servos, each a second-order system solved in closed form.

An inner setpoint runs towards the last goal at no more than the joint's own speed cap (the servo's
speed register does the same), and the joint follows it as a critically damped system::

    q'' = w^2 (s - q) - 2 w q',      w = 1 / TIME_CONSTANT

Between two calls the goal is constant, so the inner setpoint is one ramp and one rest, and on each
of them the equation has a closed solution: the joint does not depend on how often it is read. Its
response is an average of the past of the inner setpoint, so it never moves faster than the cap and
never overshoots a goal.

Not modelled: gravity, friction, backlash, ticks, and contact with anything but what the jaw closes
on, if there are ``things``. With torque off a joint stays where it is until ``push`` moves it.
"""

from __future__ import annotations

import math
import threading

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.clock import Clock
from so101_motion.common.compliance import Compliance, Wall
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array, angle, frozen_array, is_finite, joint_angles
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT, JointReading
from so101_motion.drivers.command_record import CommandListener, SentCommand
from so101_motion.drivers.goal_limiter import GoalLimiter
from so101_motion.drivers.things import Things

TIME_CONSTANT = 0.02
"""How slowly a joint follows [s]. Chosen: the servo's derivative term looks back 20 ms, so it
cannot answer much faster; a moving joint is then 40 ms behind its setpoints."""

MAX_SPEED = 2700.0 / 4096.0 * 2.0 * np.pi
"""The joints' own speed cap [rad/s]: 2700 ticks/s is where a builder measured a loaded STS3215 to
level off at 12.3 V."""

MAX_ACCELERATION = np.radians(1000.0)
"""Commands whose speed changes faster than this are refused [rad/s^2], as on a real arm."""

_STIFFNESS = 37.0
"""Torque of the jaw against what stops it, by the distance to its goal [N m/rad], as a 12 V servo
has with a P gain of 32."""

_JOINTS = (*ARM_JOINTS, GRIPPER_JOINT)


class SimArm:
    """Six simulated joints; fits ``JointDriver``.

    Besides a driver's methods it has those of a person at the arm: push it, hold a joint fast,
    break the connection. They may be called from any thread.

    ``q``, shape (5,), and ``q_jaw`` are where it starts [rad]. ``on_command`` is called with every
    command as it is taken, on the caller's thread; None for nobody. ``things`` are what its jaw can
    grip.
    """

    def __init__(
        self,
        clock: Clock,
        q: ArrayLike | None = None,
        q_jaw: float = 0.0,
        things: Things | None = None,
    ) -> None:
        q = joint_angles("q_start", np.zeros(5) if q is None else q)
        q_jaw = angle("q_jaw_start", q_jaw)
        if not is_finite(q):
            raise ConfigError("q_start", q.tolist(), "must be five finite angles [rad]")
        self.on_command: CommandListener | None = None
        self.things = things
        self._jaw_stop = -math.inf
        self._clock = clock
        self._lock = threading.Lock()
        self._t = clock.now()
        self._q = np.append(q, q_jaw)
        self._qd = np.zeros(6)
        self._inner = self._q.copy()
        self._goal = self._q.copy()
        self._jammed = np.zeros(6, dtype=bool)
        self._torque = self._yields = False
        self._limiter = GoalLimiter(_JOINTS, speed=MAX_SPEED, acceleration=MAX_ACCELERATION)
        self._failure: Exception | None = None

    # What a driver does

    def read(self) -> JointReading:
        with self._lock:
            self._follow()
            return JointReading(
                q=self._q[:5], qd=self._qd[:5], q_jaw=float(self._q[5]), qd_jaw=float(self._qd[5])
            )

    def write(
        self,
        q_cmd: Array,
        q_jaw_cmd: float,
        qd_cmd: Array | None = None,
        qdd_cmd: Array | None = None,
        follows_target: bool = False,
        room: float = 0.0,
    ) -> None:
        """Send the arm joints to ``q_cmd``, shape (5,), and the jaw to ``q_jaw_cmd`` [rad].

        ``CommandRefused`` if it is further than the caps of driven joints allow, as on a real arm.
        These joints have no lag, so ``qdd_cmd`` and what comes after it do nothing.
        """
        with self._lock:
            self._follow()
            self._check(q_cmd, q_jaw_cmd, qd_cmd)
            self._goal = np.append(self._goal[:5] if self._yields else q_cmd, q_jaw_cmd)
            if self.on_command is not None:
                self.on_command(
                    SentCommand(
                        t=self._t,
                        q_cmd=tuple(self._goal[:5].tolist()),
                        q_jaw_cmd=q_jaw_cmd,
                        goals={},
                        is_guided=self._yields,
                        is_seed=not self._torque,
                    )
                )

    def set_torque(self, on: bool) -> None:
        """Let go of the joints, or drive them from where they are to the goal written last."""
        with self._lock:
            self._follow()
            self._yields = False
            if on != self._torque:
                self._torque = on
                self._inner, self._qd = self._q.copy(), np.zeros(6)

    def guide(self, compliance: Compliance | None, wall: Wall | None = None) -> None:
        """Let the arm joints be pushed by hand; they stay where they are left.

        These joints have no force, so no ``wall`` is felt.
        """
        with self._lock:
            self._follow()
            if compliance is not None and not self._torque:
                raise RuntimeError("hold the joints before they are guided")
            self._yields = compliance is not None
            self._leave_where_they_are()

    def close(self) -> None:
        with self._lock:
            self._failure = self._failure or ConnectionError("the simulated arm has been closed")

    # What happens to an arm

    @property
    def torque(self) -> bool:
        return self._torque

    def push(self, q: ArrayLike, q_jaw: float | None = None) -> None:
        """Move limp or guided joints by hand to ``q``, shape (5,), and the jaw to ``q_jaw`` [rad].

        Raises:
            RuntimeError: They are driven; nobody can turn these gears against the motor.
        """
        with self._lock:
            self._catch_up()
            if self._torque and (not self._yields or q_jaw is not None):
                raise RuntimeError("the joints are driven; let go of them before pushing them")
            self._q[:5] = frozen_array(q, (5,))
            if q_jaw is not None:
                self._q[5] = q_jaw
            if self._yields:
                self._leave_where_they_are()

    def jam(self, joint: str) -> None:
        """Hold ``joint`` fast where it is, whatever its goal."""
        with self._lock:
            self._catch_up()
            self._jammed[_JOINTS.index(joint)] = True

    def unjam(self, joint: str) -> None:
        with self._lock:
            self._catch_up()
            i = _JOINTS.index(joint)
            self._jammed[i] = False
            self._inner[i] = self._q[i]  # the servo sets off from here, at its capped speed

    def disconnect(self, failure: Exception) -> None:
        """Make every exchange raise ``failure`` from now on; the joints go on to their goals."""
        with self._lock:
            self._failure = failure

    def reconnect(self) -> None:
        with self._lock:
            self._failure = None

    # How

    def _check(self, q_cmd: Array, q_jaw_cmd: float, qd_cmd: Array | None) -> None:
        q = [*np.asarray(q_cmd, dtype=float).tolist(), q_jaw_cmd]
        if self._torque and not self._yields:
            qd = None if qd_cmd is None else qd_cmd.tolist()
            self._limiter.follow(q, qd, self._t, self._q.tolist())
        else:
            self._limiter.begin(q, q, self._t)

    def _follow(self) -> None:
        if self._failure is not None:
            raise self._failure
        self._catch_up()

    def _leave_where_they_are(self) -> None:
        self._inner[:5] = self._goal[:5] = self._q[:5]
        self._limiter.begin(goal := self._goal.tolist(), goal, self._t)
        self._qd[:5] = 0.0

    def _catch_up(self) -> None:
        now = self._clock.now()
        dt, self._t = now - self._t, now
        if self._torque and dt > 0.0:
            self._drive(dt)
        if self.things is not None:
            short = (self._jaw_stop - self._goal[5]) if self._torque else 0.0
            self._jaw_stop = self.things.follow(self._q, _STIFFNESS * max(short, 0.0))

    def _drive(self, dt: float) -> None:
        jammed_at = self._q[self._jammed]
        away = self._goal - self._inner
        ramp = np.minimum(np.abs(away) / MAX_SPEED, dt)
        self._respond(np.sign(away) * MAX_SPEED, ramp)
        arrived = ramp < dt
        self._inner[arrived] = self._goal[arrived]
        self._respond(np.zeros(6), dt - ramp)
        self._q[self._jammed], self._qd[self._jammed] = jammed_at, 0.0
        if self._q[5] < self._jaw_stop:
            self._q[5], self._qd[5] = self._jaw_stop, 0.0

    def _respond(self, speed: Array, dt: Array) -> None:
        """Move on by ``dt``, shape (6,), while the inner setpoint runs at ``speed``, shape (6,).

        With the lag of a steady ramp, 2 speed / w, taken out, the equation is the homogeneous one:
        ``y = (y0 + (y0' + w y0) t) exp(-w t)``.
        """
        w = 1.0 / TIME_CONSTANT
        lag = 2.0 * speed / w
        y, yd = self._q - self._inner + lag, self._qd - speed
        slope = yd + w * y
        decay = np.exp(-w * dt)
        y_after = (y + slope * dt) * decay
        self._inner = self._inner + speed * dt
        self._q = self._inner - lag + y_after
        self._qd = speed + slope * decay - w * y_after
