"""Limit the torques that the servos exert: while holding still and along a motion.

There are two caps, both shares of a servo's stall torque. *Holding* is the torque a servo may bear
standing still for any time: if gravity alone needs more anywhere, the motion is refused. *Moving*
is the torque it may exert during a motion, for gravity and inertia together: where a motion needs
more, it is slowed down.

Slowing down does not reduce gravity, so a refusal names the joint, the torque and the
configuration. In a motion that is ``k`` times slower the inertial part falls with ``k^2``, which
gives directly how much slower it must be. Along a path the limits are two more rows for each joint
in :mod:`retime`, so that only the heavy part of it takes longer.

Of servos that a driver knows (``Drive``) a motion is also slowed down until they have the drive for
it: with their supply, against the voltage that their speed induces, their friction, and the load
that was felt in the gripper. This never refuses a motion: what was felt is not certain, and a
servo that has not enough drive falls behind and catches up.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import so101_description

from so101_motion.common.attributes import HEAVIEST, LoadConfig
from so101_motion.common.errors import ConfigError, Overloaded
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg
from so101_motion.native.library import quick
from so101_motion.planning.collision.scene import Attached
from so101_motion.planning.timing.path_geometry import PathPoints
from so101_motion.planning.timing.trajectory import Trajectory

if TYPE_CHECKING:
    from so101_motion.planning.kinematics.model import RobotModel

STALL = so101_description.ROBOT.stall
"""Stall torque of the servos by their rated voltage [V], [N m]; those of the two STS3215 that the
SO-101 is sold with are 19.5 and 30 kg cm (Feetech's data sheets of the C001 and the C018)."""

STRONGEST = max(STALL)  # rated voltage of the stronger of the two [V]

HOLDING = 0.6
"""Share of the stall torque that a servo may hold. Chosen. The makers rate a third (6.5 and 10 kg
cm), but the bare arm stretched out already needs 0.45 of the weaker servo's; a published test of
half the stronger one's, 15 kg cm, settled at 48 degC; at 0.8 the servo switches itself off after
two seconds."""

MOVING = 0.75  # while moving; chosen below 0.8, where its overload timer starts
GRID_SHARE = 0.98  # of what gravity leaves, for the profile; chosen, the rest for smoothing
DRIVE = 0.85
"""Largest share of its drive that a servo needs in a plan. Chosen: full drive is 0.97, supplies sag
by 5 % under load, and what is known of a servo and its load may be off by as much."""

_SLOWER = (1.0, 1.1, 1.25, 1.5, 2.0, 3.0, 4.0)  # times that a motion is slowed down for its drive
_EVERY = 4  # samples between checks of gravity
NEARLY = 0.85  # share of the holding limit that counts as near; chosen
_STEP = 1e-4  # step of the differences for gradients [rad]
_TOLERANCE = 1e-3  # of a limit, relative; chosen far below the masses' error


@dataclass(frozen=True, slots=True, kw_only=True)
class Payload:
    """The mass that the gripper carries.

    Attributes:
        mass: Its mass [kg].
        com: Its centre of mass in the tool frame, x, y, z [m].
    """

    mass: float
    com: tuple[float, float, float]

    def __post_init__(self) -> None:
        if not 0.0 <= self.mass <= HEAVIEST:
            raise ConfigError("payload", self.mass, f"must be 0 to {HEAVIEST:g} kg")
        if len(self.com) != 3 or not all(abs(x) <= 1.0 for x in self.com):
            raise ConfigError("payload", self.com, "its centre must be three values within 1 m")

    @classmethod
    def of(cls, load: LoadConfig, model: RobotModel) -> Payload | None:
        """The payload in a configuration, by default at the jaw's tip; None if there is none."""
        if load.mass <= 0.0:
            return None
        x, y, z = place_in_hand(model).tolist() if load.com is None else load.com
        return cls(mass=load.mass, com=(x, y, z))


def place_in_hand(model: RobotModel) -> Array:
    """Default centre of mass of a held object in the tool frame: the tip of the jaw, (3,), [m]."""
    zero = np.zeros(5)
    return (model.frame(zero).inverse @ model.frame(zero, "jaw_tip")).p


def carried(payload: Payload | None, attached: Iterable[Attached]) -> Payload | None:
    """Combine payload and held objects into one payload; None if it weighs nothing.

    Args:
        payload: The payload that the gripper always carries.
        attached: The objects it holds now; each has its centre of mass at its origin.
    """
    loads = [payload] if payload is not None else []
    for held in attached:
        x, y, z = held.T_tool_object.p.tolist()
        loads.append(Payload(mass=held.mass, com=(x, y, z)))
    loads = [load for load in loads if load.mass > 0.0]
    if not loads:
        return None
    mass = sum(load.mass for load in loads)
    x, y, z = (sum(load.mass * load.com[i] for load in loads) / mass for i in range(3))
    return Payload(mass=mass, com=(x, y, z))


class Drive(NamedTuple):
    """What the arm's servos can do with their supply, and what they carry; values by joint."""

    stall: tuple[float, ...]  # torque at rest [N m]
    fastest: tuple[float, ...]  # speed without torque [rad/s]
    friction: tuple[float, ...]  # torque that friction takes without load [N m]
    growth: tuple[float, ...]  # torque to lift a load, as a share of the load
    volts: float  # the lowest supply of a servo [V]
    felt: float  # mass that was felt in the gripper [kg]


@dataclass(frozen=True, slots=True, kw_only=True)
class Strength:
    """The torque limits of the servos."""

    holding: float  # torque limit of a nominal servo standing still [N m]
    moving: float  # torque limit of a nominal servo in motion [N m]
    # share of these limits for each joint's own servo, at most 1
    shares: tuple[float, ...] = (1.0,) * len(ARM_JOINTS)
    drive: Drive | None = None  # None if it is not known

    @classmethod
    def of_servos(cls, voltage: float) -> Strength:
        """The limits of the servos for ``voltage`` [V], 7.4 or 12."""
        stall = STALL.get(voltage)
        if stall is None:
            known = " or ".join(f"{each:g}" for each in STALL)
            raise ConfigError("servo_voltage", voltage, f"must be {known}, the servos' rated volts")
        return cls(holding=HOLDING * stall, moving=MOVING * stall)

    def limits(self) -> tuple[Array, Array]:
        """The holding and the moving limit of each joint, shapes (5,), [N m]."""
        return self.holding * np.array(self.shares), self.moving * np.array(self.shares)


class TorqueReserve(NamedTuple):
    """A joint that is near its torque limit, or beyond it."""

    joint: str  # its name
    left: float  # share of its holding limit that is left; negative if it is overloaded
    gradient: Array  # derivative of that by each joint, shape (5,), [1/rad]


class Load:
    """Checks the torques of the motions of one request.

    An arm that starts overloaded may leave that configuration: its load there is allowed along the
    path, but not at the end of the path.

    Args:
        model: The arm with its payload.
        strength: Torque limits of its servos.
        q_start: Joint angles at the start of the motions, shape (5,), [rad].
        payload: The payload of ``model``, for messages.

    Attributes:
        short_of_drive: Why a motion was slowed down for want of drive; empty if none was.
        known: Address of what it knows of the torques nearby, for ``guard.c``.
    """

    def __init__(
        self, model: RobotModel, strength: Strength, q_start: Array, payload: Payload | None
    ) -> None:
        self._model, self._strength, self._payload = model, strength, payload
        self._is_weak = strength.moving < MOVING * STALL[STRONGEST]
        self.short_of_drive = ""
        self._newest: tuple[Trajectory, Array] | None = None
        self._felt, known = model, 0.0 if payload is None else payload.mass
        if strength.drive is not None and strength.drive.felt > known:
            more = strength.drive.felt - known
            self._felt = model.with_payload(more, tuple(place_in_hand(model).tolist()))
        self._may_hold, self._may_move = strength.limits()
        there = np.abs(model.holding_torques(q_start[None]))[0]
        # Angles, torques without signs there, limits, and how much each angle changes each torque.
        self._known = np.empty((8, 5))
        self._known[2], self._known[3:] = self._may_hold, model.holding_torque_rates.T
        self.known = self._known.ctypes.data
        self._know(q_start, there)
        self._holding = np.maximum(self._may_hold, there)
        too_much = np.where(there > self._may_hold, there, 0.0)
        self._moving = np.maximum(self._may_move, MOVING / HOLDING * too_much)

    @classmethod
    def of(
        cls, model: RobotModel, strength: Strength, q_start: Array, payload: Payload | None
    ) -> Load:
        """Make a ``Load`` for ``model`` without its payload, which is added here."""
        loaded = model if payload is None else model.with_payload(payload.mass, payload.com)
        return cls(loaded, strength, q_start, payload)

    def check_goal(self, q: Array) -> None:
        """Refuse a configuration ``q``, shape (5,), [rad], that the servos cannot hold.

        Raises:
            Overloaded: As for :meth:`check_holding`, without the exception for the start.
        """
        self._check_holding(q[None], self._may_hold, "at the goal")

    def check_holding(self, q: Array, where: str) -> float:
        """Refuse configurations ``q`` (m, 5) [rad] in which gravity alone is too much.

        Args:
            q: The configurations.
            where: The end of the message, such as ``"on the way"``.

        Returns:
            The largest share of a holding limit that is used.

        Raises:
            Overloaded: Names the joint that is furthest off, its torque and its limit.
        """
        return self._check_holding(q, self._holding, where)

    def heavy(self, q: Array) -> list[TorqueReserve]:
        """The joints near their holding limit at ``q``, shape (5,), [rad]."""
        if self._is_surely_within(NEARLY, q, q):
            return []
        torques = self._learn(q)
        left = 1.0 - np.abs(torques) / self._may_hold
        heavy = np.flatnonzero(left < 1.0 - NEARLY)
        if len(heavy) == 0:
            return []
        around = self._model.holding_torques(q + _STEP * np.eye(5))
        gradients = (torques - around) * (np.sign(torques) / (_STEP * self._may_hold))
        return [TorqueReserve(ARM_JOINTS[i], float(left[i]), gradients[:, i]) for i in heavy]

    def admits(self, path: Array) -> bool:
        """Whether the servos can hold every configuration of ``path``, shape (m, 5), [rad].

        A joint that is overloaded at the start of the path must not get more load on it.
        """
        low, high = path.min(axis=0), path.max(axis=0)
        if self._is_surely_within(1.0, low, high):
            return True
        self._learn(0.5 * (low + high))
        if self._is_surely_within(1.0, low, high):
            return True
        borne = np.abs(self._model.holding_torques(path))
        self._know(path[0], borne[0])
        allowed = np.maximum((1.0 + _TOLERANCE) * self._may_hold, borne[0])
        return bool((borne <= allowed).all())

    def _learn(self, q: Array) -> Array:
        """Compute and remember the holding torques at ``q``, shapes (5,), [rad], [N m]."""
        torques: Array = self._model.holding_torques(q[None])[0]
        self._know(q, np.abs(torques))
        return torques

    def _know(self, q: Array, borne: Array) -> None:
        """Remember the holding torques without signs at ``q``, shapes (5,), [rad], [N m]."""
        self._known[0], self._known[1] = q, borne

    def _is_surely_within(self, share: float, low: Array, high: Array) -> bool:
        """Quick proof, from known torques nearby, that all between two corners is bearable.

        All torques stay below ``share`` of their limits.
        """
        corners = np.array((low, high))
        return bool(quick().so101_surely_borne(self.known, share, corners.ctypes.data))

    def check(self, trajectory: Trajectory) -> float:
        """Refuse a motion that overloads a servo.

        Returns:
            The largest share of a moving limit that is used.

        Raises:
            Overloaded: As for :meth:`check_holding`.
        """
        self.check_holding(trajectory.q[::_EVERY], "on the way")
        torques = self._torques(trajectory)
        shares = np.abs(torques) / self._moving
        k, i = np.unravel_index(int(np.argmax(shares)), shares.shape)
        if shares[k, i] > 1.0 + _TOLERANCE:
            torque = float(torques[k, i])
            q = trajectory.q[k]
            raise self._overloaded(q, int(i), torque, self._moving, "move", "on the way")
        return float(shares[k, i])

    def stretch(self, trajectory: Trajectory) -> float:
        """The factor by which a motion must be slowed for its servos to bear it; at least 1.

        Gravity alone must be bearable, see :meth:`check_holding`.
        """
        drive = self._strength.drive
        slower = 1.0 if drive is None else self._stretch_to_drive(trajectory, drive)
        torques = self._torques(trajectory)
        over = np.flatnonzero(np.any(np.abs(torques) > self._moving, axis=1))
        if len(over) == 0:
            return slower
        gravity = self._model.holding_torques(trajectory.q[over])
        inertial = torques[over] - gravity
        left = np.maximum(self._moving - np.sign(inertial) * gravity, 1e-3 * self._moving)
        return max(slower, math.sqrt(max(1.0, float(np.max(np.abs(inertial) / left)))))

    def _stretch_to_drive(self, trajectory: Trajectory, drive: Drive) -> float:
        """The least of ``_SLOWER`` that leaves the servos enough drive, as far as that helps."""
        q, qd, qdd = trajectory.q[::_EVERY], trajectory.qd[::_EVERY], trajectory.qdd[::_EVERY]
        gravity = self._felt.holding_torques(q)
        inertial = self._felt.torques(q, qd, qdd) - gravity
        stall, fastest, friction, growth = (np.array(each) for each in drive[:4])

        def needed(slower: float) -> float:
            lifted = np.sign(qd) * (gravity + inertial / slower**2)
            torque = friction + np.where(lifted > 0.0, growth, 1.0) * lifted
            share = np.maximum(torque, 0.0) / stall + np.abs(qd) / slower / fastest
            return float(np.where(qd == 0.0, 0.0, share).max())

        at_once = needed(1.0)
        enough = max(DRIVE, needed(_SLOWER[-1]) + 0.05)
        if at_once > DRIVE:
            self.short_of_drive = (
                f"moves slower than its caps: a servo would need {at_once:.0%} of its drive at"
                f" {drive.volts:.1f} V, with {max(drive.felt, 0.0) * 1e3:.0f} g felt in the gripper"
            )
        return next(each for each in _SLOWER if needed(each) <= enough)

    def rows(self, points: PathPoints) -> Array:
        """The torque limits along a path, for :func:`retime.retime`.

        With ``q = q(s)`` joints have the velocity ``q_s s'`` and the acceleration
        ``q_s s'' + q_ss s'^2``. Torque is linear in accelerations and quadratic in velocities, so
        it is ``a s'' + b s'^2 + gravity``.
        """
        q, q_s, q_ss = points
        still = np.zeros_like(q)
        gravity = self._model.holding_torques(q)
        a = self._model.torques(q, still, q_s) - gravity
        b = self._model.torques(q, q_s, q_ss) - gravity
        limit = np.abs(gravity) + GRID_SHARE * (self._moving - np.abs(gravity))
        return np.stack((a, b, gravity)) / limit

    def _check_holding(self, q: Array, limits: Array, where: str) -> float:
        torques = self._model.holding_torques(q)
        shares = np.abs(torques) / limits
        k, i = np.unravel_index(int(np.argmax(shares)), shares.shape)
        if shares[k, i] > 1.0 + _TOLERANCE:
            raise self._overloaded(q[k], int(i), float(torques[k, i]), limits, "hold", where)
        return float(shares[k, i])

    def _torques(self, trajectory: Trajectory) -> Array:
        """The joints' torques along a motion; those of the last motion are cached."""
        if self._newest is None or self._newest[0] is not trajectory:
            torques = self._model.torques(trajectory.q, trajectory.qd, trajectory.qdd)
            self._newest = trajectory, torques
        return self._newest[1]

    def _overloaded(
        self, q: Array, i: int, torque: float, limits: Array, verb: str, where: str
    ) -> Overloaded:
        limit, mass = float(limits[i]), self._payload.mass if self._payload else 0.0
        load = f"the arm and {mass * 1e3:.0f} g" if mass else "the arm"
        advice = "reach less far" + (", or carry less" if mass else "")
        if self._is_weak:
            advice += f'; servos for {STRONGEST:g} V bear more: set "servo_voltage" if it has those'
        own = float((self._may_hold if verb == "hold" else self._may_move)[i])
        may = f"its servo may exert {own:.2f} N m"
        if self._strength.shares[i] < 1.0:
            may += f", {self._strength.shares[i]:.0%} of its type's, as it was identified"
        if limit > own:
            may += f", and no more than {limit:.2f} to leave where it stands overloaded"
        return Overloaded(
            f"{ARM_JOINTS[i]} would have to exert {abs(torque):.2f} N m to {verb} {load} {where}"
            f" (at {', '.join(f'{to_deg(angle):.0f}' for angle in q.tolist())} deg); {may};"
            f" {advice}",
            joint=ARM_JOINTS[i],
            torque=torque,
            limit=limit,
            q=q.copy(),
        )


def slowed(trajectory: Trajectory, k: float) -> Trajectory:
    """The same motion, ``k >= 1`` times slower, with the same time between its samples."""
    last = (len(trajectory) - 1) * trajectory.dt
    count = math.ceil(k * last / trajectory.dt - 1e-9) + 1
    t = np.minimum(np.arange(count) * (trajectory.dt / k), last)
    q, qd, qdd = trajectory.at(t)
    q[-1], qd[-1], qdd[-1] = trajectory.q[-1], 0.0, 0.0
    return Trajectory(dt=trajectory.dt, q=q, qd=qd / k, qdd=qdd / k**2, duration=k * last)
