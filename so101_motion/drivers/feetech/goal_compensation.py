"""Compute the goals of the six servos from the commanded joint angles.

A goal lies beyond the commanded angle: by the distance that weight and friction make the servo give
way (``gravity_compensation.py``) and by its lag at speed (``lag_compensation.py``). How far the
command may move and how much may be added to it is bounded in one place, the last before the bus:
``goal_limiter.py``. The goals sent are remembered: under its load a joint stands a little off its
goal, and has to keep that distance when it is commanded to stay.

``Reversals``: where a joint turns round, its friction changes sides, and unless its load presses
its gears to one side, its motor has to cross the play before the joint follows. If compensation
starts only when the joint has turned, the joint is a degree behind. So the compensation of friction
changes sides shortly before, and the motor is driven through the play while the joint hardly moves.
A load that changes sides takes a joint through the play as well; then the motor has to bring it
back. The turn has to be known in advance, so this is done in planned motions only; and a motor is
driven through the play only if an identification has measured it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence

from so101_motion.common.units import to_rad
from so101_motion.drivers.bus.registers import LET_GO, Fault
from so101_motion.drivers.bus.ticks import JointMap, Ticks
from so101_motion.drivers.feetech.gravity_compensation import Gravity, Trim
from so101_motion.drivers.feetech.lag_compensation import (
    DELAY,
    braking,
    cut_off,
    stopping_distance,
)
from so101_motion.drivers.feetech.servo_model import ServoModel
from so101_motion.drivers.feetech.servo_setup import ServoCondition
from so101_motion.drivers.goal_limiter import SLACK, GoalLimiter, within_change
from so101_motion.drivers.servo_types import AS_SOLD, ServoFigures

EARLY = 1.2
"""How long before a joint turns round its friction begins to change sides, as a share of half the
time that the servo's set-point needs for that step. Chosen by trial."""

FLIP = 0.04
"""Time in which friction changes sides [s]; chosen by trial."""

CROSSING = 0.06
"""Time in which a motor is driven through the play the way its joint goes [s]; chosen by trial."""

TAKEN_BACK = 0.25
"""Time in which it is driven through the play the other way, under a load that leads its joint on
[s]. Chosen: if the load is not what the driver takes it for, the joint is slower for that time
instead of standing."""

STANDS = to_rad(1.0)
"""Nothing is predicted for a slower joint [rad/s]. Chosen."""

PRESSED = 0.03
"""A smaller load may not keep the gears on its side [N m]; chosen by trial."""

_N = 5


class Reversals:
    """Predicts the sides of friction and play of the arm joints.

    ``crossing`` is the speed at which each motor is driven through the play now [rad/s].
    """

    def __init__(self, trim: Trim) -> None:
        self._trim = trim
        self._side = [0.0] * _N  # of the play, on which the motor is, -1 to 1
        self.crossing = [0.0] * _N

    def unknown(self) -> None:
        self.crossing = [0.0] * _N

    def foresee(self, qd: Sequence[float], qdd: Sequence[float], dt: float) -> list[float | None]:
        """The side to which each joint's friction is to be compensated now, and how fully, -1 to 1.

        None for a joint that hardly moves: it may be coming to rest, or creep on for long. ``qd``
        is commanded [rad/s], ``qdd`` its change from now on [rad/s^2], ``dt`` the time since the
        last call [s], 0 if the clock has not gone on.
        """
        ways: list[float | None] = []
        for i, (speed, change) in enumerate(zip(qd, qdd, strict=True)):
            model, way = self._trim.models[i], None
            weight, play = self._trim.weights[i], model.figures.play
            ahead = speed
            if change:
                turn = 2.0 * model.friction(weight, 1.0) / model.stiffness
                early = EARLY * math.sqrt(turn / model.braking)
                ahead += (DELAY + model.kind.goal_delay + early) * change
            self.crossing[i] = 0.0
            if abs(ahead) > STANDS:
                way = within_change(math.copysign(1.0, ahead), self._trim.ways[i], 2.0 * dt / FLIP)
            if play and dt > 0.0 and (abs(ahead) > STANDS or abs(weight) > PRESSED):
                before = self._side[i]
                wanted = math.copysign(1.0, weight if abs(weight) > PRESSED else ahead)
                takes = CROSSING if wanted * ahead >= 0.0 else TAKEN_BACK
                self._side[i] = within_change(wanted, before, 2.0 * dt / takes)
                self.crossing[i] = 0.5 * play * (self._side[i] - before) / dt
            ways.append(way)
        return ways


_AHEAD = 0.06
"""Time from sending a goal until it acts [s]: delay and lag together, at a P gain of 32."""

_SMOOTHING = 0.1
"""Weight of a new reading of the supply in its average; ten come a second."""


_RECENT = 0.05
"""A servo's set-point is predicted over no more time than this [s]."""


_SLOW = 0.03
"""Below this speed the lag is so small that its compensation may start and end at once [rad/s]."""

_BLEND = 0.5
"""Time in which the compensation is faded in or out otherwise [s]; chosen, longer than a stop."""

_TURNING, _FOLLOWING_SHARE, _FOLLOWING_BRAKING = to_rad(60.0), 0.4, 0.8
"""For a joint that follows a target: below the first [rad/s] its lag is compensated less, down to
the second as a share; and its set-point accelerates by at most the third, as a share of its
braking. A servo that turns round has to cross its play; with a set-point as far ahead as in a
planned motion it would then accelerate harder than any joint may. Chosen by trial."""

_MOST_AHEAD = to_rad(40.0)
"""Largest lead over the command of a joint that follows a target [rad]. Chosen: 5 deg more than the
slowest braking servo needs at 180 deg/s without lag compensation."""

_GIVEN_UP = 2.0
"""Time in which the offset of uncompensated joints is faded out [s]; chosen: they sag slowly."""


class GoalCompensation:
    """Adds the compensation to commands; in plain lists, which are faster than numpy for six.

    Servos (``maps``) and how they were found to differ from their type (``figures``) are by index;
    ``per_kg`` is the additional torque for each kilogram in the hand, None if unknown. If it is not
    to compensate anything, the offsets at which the servos were found are faded out within
    ``_GIVEN_UP``.

    Attributes:
        q: Commanded joint angles [rad].
        held: The servos' goals; None for one that is limp, or whose goal is not known.
        is_set: Whether there has been a command since the servos were found.
    """

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
        self.q = [0.0] * 6
        self.held: list[Ticks | None] = [None] * 6
        self.is_set = False
        self.weak: set[int] = set()
        self._compensates, self._t_begin = compensates, 0.0
        self._maps, self._figures = maps, figures
        self._qd: Sequence[float] | None = None
        self._qdd: Sequence[float] = (0.0,) * 5
        self._is_told = False  # how the speeds change
        self._follows_target = False
        self._t_point = -math.inf
        self._foreseen = [0.0] * 6  # what share of the lag is made up for
        self._setpoint_qd = [0.0] * 6  # of the servos' own set-points [rad/s]
        self._lags = [0.0] * 6  # how far joints would stay behind, were nothing done [rad]
        self._t_goals = 0.0
        self._reversals = Reversals(self.trim)

    def found(self, i: int, servo: ServoCondition) -> None:
        self.held[i] = servo.goal_ticks if servo.torque else None
        self.weak.discard(i)
        brakes = braking(i, servo.max_acceleration)
        own = self._figures.get(i, AS_SOLD)
        self.trim.models[i] = ServoModel(servo.kind, servo.p_gain, brakes, own)
        self.trim.models[i].most_drive = servo.torque_limit / 1000.0

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
        self.q, self._qd, self.is_set, self._t_begin = q, None, True, now
        self.trim.start(q, now, [self._sag(i) for i in range(6)])

    def point(
        self,
        q: list[float],
        qd: Sequence[float] | None,
        now: float,
        here: Callable[[int], float],
        free: Collection[int],
        qdd: Sequence[float] | None = None,
        *,
        follows_target: bool = False,
    ) -> None:
        """Take the next command, ``q`` [rad], at ``now`` [s]; see ``GoalLimiter.follow``.

        ``qd`` [rad/s] has NaN where it is not known; ``qdd`` [rad/s^2] is None if not known. A
        joint that follows a target (``follows_target``), and not a plan, may turn round at any
        moment.
        """
        self._limiter.follow(q, qd, now, here, free)
        self.q = q
        known = None if qd is None else [0.0 if math.isnan(each) else each for each in qd]
        self._is_told, self._follows_target = qdd is not None, follows_target
        # While lag compensation is faded out, a set-point must not run on as the joint slows.
        self._qdd = qdd or self._changes(known, now)
        dt = now - self._t_point
        ways: Sequence[float | None] = (None,) * 5
        if known is not None and qdd is not None and not follows_target:
            ways = self._reversals.foresee(known, qdd, dt if dt < _RECENT else SLACK)
        else:
            self._reversals.unknown()
        self._qd, self._t_point = known, now
        self.trim.command(q, now, self._qd or (0.0,) * 5, _AHEAD, ways)
        for i, each in enumerate(qd or ()):
            if math.isnan(each):  # it stays where it is
                self._setpoint_qd[i] = 0.0
                self.trim.give_way(i)

    def goals(self, now: float, absent: Collection[int] = ()) -> dict[int, Ticks]:
        """The goals to send, by servo; ``absent`` servos are left out."""
        offset, lead = self.trim.offset, [0.0] * 6
        dt, self._t_goals = min(now - self._t_goals, _RECENT), now
        if self._qd is None:
            self._setpoint_qd = [0.0] * 6
            self._lags, self.trim.lags = [0.0] * 6, [0.0] * 6
        else:
            for i, qd in enumerate(self._qd):
                lead[i] = self._lead(i, qd, self._qdd[i], dt)
        if not self._compensates:
            left = max(1.0 - (now - self._t_begin) / _GIVEN_UP, 0.0)
            offset, lead = [left * each for each in offset], [0.0] * 6
        for i in self.weak:
            offset[i] = lead[i] = 0.0
        goals = self._limiter.goals(offset, self.trim.largest, lead, now)
        return self._in_ticks(goals, absent)

    def yielded(
        self, q_goal: Sequence[float], now: float, absent: Collection[int]
    ) -> dict[int, Ticks]:
        """The goals while a hand leads the arm to ``q_goal`` [rad]; the jaw holds."""
        return self._in_ticks(self._limiter.yielded([*q_goal, self.q[5]], now), absent)

    def in_play(self) -> dict[int, float]:
        """The joints that may stand in their play now, with how far they fall behind then [rad].

        Only in planned motions: in others, what holds a joint up is not looked for. A joint whose
        motor is being driven through the play is one of them: if the load is not what the driver
        takes it for, its gears were on the other side already.
        """
        if self._follows_target or not self._is_told:
            return {}
        speeds, models = self._qd or (0.0,) * 5, self.trim.models
        crossing = (i for i, speed in enumerate(self._reversals.crossing) if speed)
        return {
            i: models[i].stray_in_play(abs(speeds[i])) for i in {*self.trim.in_play(), *crossing}
        }

    def _changes(self, qd: Sequence[float] | None, now: float) -> Sequence[float]:
        """Accelerations between the last commanded velocities and ``qd`` [rad/s^2]."""
        dt = now - self._t_point
        if qd is None or self._qd is None or not 0.0 < dt < _RECENT:
            return (0.0,) * 5
        return [(v - before) / dt for v, before in zip(qd, self._qd, strict=True)]

    def _lead(self, i: int, qd: float, qdd: float, dt: float) -> float:
        """The lead that compensates the lag of joint ``i`` at this speed and acceleration [rad]."""
        model, trim, crossing = self.trim.models[i], self.trim, self._reversals.crossing[i]
        late = DELAY + model.lag
        lag = self._lags[i]
        self._lags[i] = lag = lag + (qd * dt - min(dt / late, 1.0) * lag)
        share = self._foreseen[i]
        trim.lags[i] = (1.0 - share) * lag
        wanted = 1.0 if self._is_told else 0.0
        if abs(qd) < _SLOW:
            share = wanted
        elif share != wanted:  # one that follows a target at speed is not overtaken
            rise = 0.0 if self._follows_target else dt / _BLEND
            share += min(max(wanted - share, -dt / _BLEND), rise)
        self._foreseen[i], before = share, self._setpoint_qd[i]
        if not (qd or qdd or before or crossing):
            return 0.0
        # The set-point runs ahead of the joint; no faster than it can.
        faster = slower = model.braking * dt
        if self._follows_target:
            faster *= _FOLLOWING_BRAKING if self._is_told else 1.0
            share *= _FOLLOWING_SHARE + (1.0 - _FOLLOWING_SHARE) * min(abs(qd) / _TURNING, 1.0)
            trim.lags[i] = (1.0 - share) * lag
        low, high = (slower, faster) if before > 0.0 else (faster, slower)
        setpoint_qd = min(max(qd + share * qdd * late, before - low), before + high)
        self._setpoint_qd[i] = setpoint_qd
        # A goal sent now acts later, when the joint has moved on and is faster or slower.
        later = DELAY + model.kind.goal_delay
        behind = trim.lag(i, qd + qdd * later + crossing, qdd) + later * (qd + 0.5 * qdd * later)
        ahead = stopping_distance(setpoint_qd, model.braking) + share * behind
        ahead += self._maps[i].direction * cut_off(setpoint_qd)
        return min(max(ahead, -_MOST_AHEAD), _MOST_AHEAD) if self._follows_target else ahead

    def _in_ticks(self, goals: Sequence[float], absent: Collection[int]) -> dict[int, Ticks]:
        return {
            joint.servo_id: joint.to_goal(goals[i])
            for i, joint in self._maps.items()
            if joint.servo_id not in absent
        }

    def _sag(self, i: int) -> float | None:
        """Distance from joint ``i``'s command to its servo's goal [rad]; None if limp."""
        held = self.held[i]
        return None if held is None else self._maps[i].to_rad(held) - self.q[i]
