"""Compute the goals of the six servos from the commanded joint angles.

A goal lies beyond the commanded angle: by the distance that weight and friction make the servo give
way (``gravity_compensation.py``) and by its lag at speed (``lag_compensation.py``). How far the
command may move and how much may be added to it is bounded in one place, the last before the bus:
``goal_limiter.py``. The goals sent are remembered: under its load a joint stands a little off its
goal, and has to keep that distance when it is commanded to stay.

``foresee`` in C: where a joint turns round, its friction changes sides, and unless its load presses
its gears to one side, its motor has to cross the play before the joint follows. If compensation
starts only when the joint has turned, the joint is a degree behind. So the compensation of friction
changes sides shortly before, and the motor is driven through the play while the joint hardly moves.
A load that changes sides takes a joint through the play as well; then the motor has to bring it
back. The turn has to be known in advance, so this is done in planned motions only; and a motor is
driven through the play only if an identification has measured it.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from so101_motion.drivers.bus.registers import LET_GO, Fault, Register
from so101_motion.drivers.bus.ticks import JointMap, Ticks
from so101_motion.drivers.feetech.gravity_compensation import LARGEST_DRIVE, Gravity, Trim
from so101_motion.drivers.feetech.lag_compensation import DELAY, braking
from so101_motion.drivers.feetech.servo_model import LARGEST_SAG, ServoModel
from so101_motion.drivers.feetech.servo_setup import ServoCondition
from so101_motion.drivers.goal_limiter import SIX, GoalLimiter, Six, as_bits
from so101_motion.drivers.servo_types import AS_SOLD, ServoFigures
from so101_motion.native.library import quick

LIMP = -(1 << 20)
"""Instead of the goal of a servo that is limp, or whose goal is not known; as in ``servos.h``."""

_STILL = (0.0,) * 5
_Given = ctypes.c_double * 28  # as so101_goals_point takes them

_AHEAD = 0.06
"""Time from sending a goal until it acts [s]: delay and lag together, at a P gain of 32."""

_SMOOTHING = 0.3
"""Weight of a new reading of the supply in its average; ten come a second."""


class GoalCompensation(ctypes.Structure):
    """Adds the compensation to commands; computed in ``servo_goals.c``.

    Servos (``maps``) and how they were found to differ from their type (``figures``) are by index;
    ``per_kg`` is the additional torque for each kilogram in the hand, None if unknown. If it is not
    to compensate anything, the offsets at which the servos were found are soon faded out.

    Attributes:
        q: Commanded joint angles [rad], an array of C.
        held: The servos' goals; ``LIMP`` for one that is limp, or whose goal is not known.
        is_set: Whether there has been a command since the servos were found.
        weak: The joints whose servos do not drive, or must not yet.
        crossing: The speed at which each motor is driven through its play now [rad/s].
    """

    _fields_ = [
        *((name, ctypes.c_double) for name in ("delay", "ahead", "largest_offset", "compensates")),
        *((name, SIX) for name in ("direction", "zero_ticks", "lower_ticks", "upper_ticks")),
        *((name, ctypes.c_double) for name in ("t_begin", "t_point", "t_goals", "has_qd")),
        *((name, ctypes.c_double) for name in ("is_told", "follows_target")),
        *((name, ctypes.c_double * 5) for name in ("qd", "qdd", "side", "crossing")),
        *((name, SIX) for name in ("foreseen", "setpoint_qd", "lags")),
        ("c_trim", ctypes.POINTER(Trim)),
        ("c_limiter", ctypes.POINTER(GoalLimiter)),
        ("servo", ctypes.c_int * 6),
        ("held", ctypes.c_int * 6),
    ]
    crossing: list[float]
    held: list[int]

    def __init__(
        self,
        maps: Mapping[int, JointMap],
        gravity: Gravity,
        limiter: GoalLimiter,
        per_kg: Gravity | None,
        figures: Mapping[int, ServoFigures],
        *,
        compensates: bool = True,
    ) -> None:
        self.trim, self._limiter = Trim(gravity, per_kg), limiter
        super().__init__(
            delay=DELAY, ahead=_AHEAD, largest_offset=LARGEST_SAG + LARGEST_DRIVE,
            compensates=compensates, t_point=-math.inf,
            c_trim=ctypes.pointer(self.trim), c_limiter=ctypes.pointer(limiter),
            held=(LIMP,) * 6,
        )  # fmt: skip
        for i, joint in maps.items():
            self.direction[i], self.zero_ticks[i] = joint.direction, joint.zero_ticks
            self.lower_ticks[i], self.upper_ticks[i] = joint.lower_ticks, joint.upper_ticks
            self.servo[i] = joint.servo_id
        self.q: Six = limiter.q
        self.is_set = False
        self.weak: set[int] = set()
        self._maps, self._figures = maps, figures
        self._in_c, self._at = quick(), ctypes.c_void_p(ctypes.addressof(self))
        self._given, self._goals, self._stray = _Given(), (ctypes.c_int * 6)(), SIX()
        self._packet: Any = ctypes.create_string_buffer(32)
        self._index = tuple((joint.servo_id, i) for i, joint in maps.items())

    def found(self, i: int, servo: ServoCondition) -> None:
        goal = servo.goal_ticks if servo.torque else None
        self.held[i] = LIMP if goal is None else goal
        self.weak.discard(i)
        brakes = braking(i, servo.max_acceleration)
        own = self._figures.get(i, AS_SOLD)
        self.trim.put(i, ServoModel(servo.kind, servo.p_gain, brakes, own))
        self.trim.models[i].most_drive = servo.torque_limit / 1000.0
        self.trim.models[i].volts = servo.volts

    def supplied(self, i: int, volts: float) -> None:
        """Take in the supply voltage that joint ``i``'s servo reports [V]."""
        self.trim.models[i].volts += _SMOOTHING * (volts - self.trim.models[i].volts)

    def heard(self, i: int, faults: int) -> None:
        """Take in the status byte of joint ``i``'s servo.

        A servo in overload does not drive again before its goal is where it stands, and one that
        has let go must hold where it is then. So nothing is added to its goal until then.
        """
        if faults and faults & (Fault.OVERLOAD | LET_GO):
            self.weak.add(i)
        elif self.weak:
            self.weak.discard(i)

    def begin(
        self, q: list[float], here: Sequence[float], now: float, free: Collection[int]
    ) -> None:
        """Take the first command: hold the joints at ``q`` [rad]; see ``GoalLimiter.begin``."""
        self._limiter.begin(q, here, now, free)
        self.is_set, self.t_begin = True, now
        self.has_qd, self.qd[:] = 0.0, [0.0] * 5
        self.trim.start(q, now, [self._sag(i) for i in range(6)])

    def point(
        self,
        q: list[float],
        qd: Sequence[float] | None,
        now: float,
        here: Six,
        free: Collection[int],
        qdd: Sequence[float] | None = None,
        *,
        follows_target: bool = False,
    ) -> None:
        """Take the next command, ``q`` [rad], at ``now`` [s]; see ``GoalLimiter.follow``.

        ``qd`` [rad/s] has NaN where it is not known; ``qdd`` [rad/s^2] is None if not known.
        ``here``, the confirmed angles [rad], is an array of C. A
        joint that follows a target (``follows_target``), and not a plan, may turn round at any
        moment. Joints that are ``free`` are kept slow by their servos.
        """
        if not self.trim.weighs_itself and q != self.q[:]:  # where they will be when the goal acts
            known = [0.0 if v != v else v for v in qd or _STILL]
            ahead = [at + _AHEAD * v for at, v in zip(q, known, strict=False)]
            self._given[16:] = [*self.trim.own([*ahead, q[5]]), *self.trim.per_kg([*ahead, q[5]])]
        self._given[:16] = [*q, *(qd or _STILL), *(qdd or _STILL)]
        refused = self._in_c.so101_goals_point(
            self._at, self._given, here, qd is not None, qdd is not None, follows_target,
            as_bits(free) if free else 0, now,
        )  # fmt: skip
        if refused >= 0:
            self._limiter.refuse(refused)

    def packet(self, register: Register, now: float, absent: Collection[int]) -> bytes:
        """The packet that writes the goals to a register of all servos but those of some joints.

        Empty if there is none to write to.
        """
        weak, without = as_bits(self.weak) if self.weak else 0, as_bits(absent) if absent else 0
        size = self._in_c.so101_goals_send(
            self._at, weak, without, register.address, now, self._packet
        )
        return bytes(self._packet[:size])

    def goals(self, now: float, absent: Collection[int] = ()) -> dict[int, Ticks]:
        """The goals to send, by servo; ``absent`` servos are left out."""
        weak = as_bits(self.weak) if self.weak else 0
        self._in_c.so101_goals(self._at, weak, ctypes.c_double(now), self._goals)
        ticks = self._goals[:]
        return {i: Ticks(ticks[k]) for i, k in self._index if i not in absent}

    def yielded(
        self, q_goal: Sequence[float], now: float, absent: Collection[int]
    ) -> dict[int, Ticks]:
        """The goals while a hand leads the arm to ``q_goal`` [rad]; the jaw holds."""
        return self._in_ticks(self._limiter.yielded([*q_goal, self.q[5]], now), absent)

    def in_play(self) -> tuple[dict[int, float], int]:
        """The joints that may stand in their play now, with how far they fall behind then [rad].

        Only in planned motions: in others, what holds a joint up is not looked for. A joint whose
        motor is being driven through the play is one of them: if the load is not what the driver
        takes it for, its gears were on the other side already. Also returns a bit for each joint
        that is held.
        """
        found = self._in_c.so101_goals_in_play(self._at, self._stray)
        return {
            i: self._stray[i] for i in range(5) if found >> i & 1
        } if found & 31 else {}, found >> 8

    def _in_ticks(self, goals: Sequence[float], absent: Collection[int]) -> dict[int, Ticks]:
        return {
            joint.servo_id: joint.to_goal(goals[i])
            for i, joint in self._maps.items()
            if joint.servo_id not in absent
        }

    def _sag(self, i: int) -> float | None:
        """Distance from joint ``i``'s command to its servo's goal [rad]; None if limp."""
        held = Ticks(self.held[i])
        return None if held == LIMP else self._maps[i].to_rad(held) - self.q[i]
