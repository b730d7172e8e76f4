"""Compensate weight and friction, so that joints come to rest where they were sent.

``Trim`` offsets the goals by the distance the servos will give way, in several parts:

*Feed-forward*, from the model: the torque that holds the commanded pose and the friction of the
motion, turned into a distance by ``servo_model.py``; it acts while the arm moves. When a joint
turns round, its friction does not change sides at once but over twice ``ENGAGING`` of travel, so a
trembling command does not shake the goals. At rest it stays on the side it was.

*What is not known*, of all servos at once: by which share each is weaker than its type and its
friction greater, how much later it comes, what else is off, the mass in the gripper, and by how
much the zeros of the three joints that lift are off, since a zero taken from the middle of the
travel may be wrong by 5 deg. That changes weights only, never a commanded angle. While the
command moves, a Kalman filter finds it from the errors: which of these is the reason shows in how
an error changes with pose, speed and direction. Errors near rest count little, because friction may
bear anything there. In motions that follow a target only joints that bear weight are looked at:
when their lag was taken for weight, a joint went up to 3 deg past the place where it was stopped.

*A slow integral at rest*: while command and joint stand still, the measured error is added up. It
first turns friction over to the side where it is needed, quickly, as long as nothing moves. What is
left is counted as what the filter takes for likely; a joint that stands without an error is no
evidence against a mass that another one feels, as long as its friction can bear it.

Servos of one type taken for the other come 0.05 s later or sooner, 5 deg at 90 deg/s. That counts
in the lead (``servo_goals.c``). It makes no joint more than 3 % faster than it is planned to be
soon (``PlannedMotion.room``): nobody asked for more, and answers that come late look the same.

An error too large for the arm's weight is not droop: the joint is held fast or still moving, and
nothing is learnt. The integral is bounded by the torque it can cause. Errors of a tick or two are
ignored, as are, half a second after the command has come to rest, all errors of joints that have
arrived: with play and friction a joint would otherwise hunt from one side of its goal to the other
for ever. The jaw has no trim: its error is the grip.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.units import to_rad
from so101_motion.drivers.feetech.arm_weight import ArmWeight
from so101_motion.drivers.feetech.servo_model import LARGEST_SAG, ServoModel
from so101_motion.drivers.goal_limiter import SIX, Six, limited
from so101_motion.native.library import quick

Gravity = Callable[[Array], Array]
"""Torque [N m] that holds the arm still at joint angles ``q`` [rad], shapes (6,), jaw included."""

ENGAGING = to_rad(0.3)
"""Half the travel over which friction changes sides when a joint turns round [rad]. Chosen: four
times the tremor of a hand that teleoperates."""

SETTLE_POSITION = to_rad(0.33)
"""How near to its goal a joint must come to have arrived [rad]: not quite four ticks; a fitted
servo that breaks loose moves by three. Chosen."""

LEFT_ALONE = to_rad(0.5)
"""Errors up to this are ignored for a joint that had arrived after ``LATE`` [rad]. Chosen: its
reading may change by a tick, and moving to and fro is worse than such an error."""

SETTLE_VELOCITY = to_rad(3.0)
"""A joint slower than this is at rest [rad/s]: its encoder was seen to scatter by 3 ticks."""

SETTLE_TIMEOUT = 2.0
"""How long settling may take [s]: ten time constants of the trim's integral."""

LARGEST_DRIVE = 1.7
"""Torque that the integral may cause [N m]. Chosen: 300 g in the jaws of the stretched arm need 1.5
at the shoulder, their friction included."""

HEAVIEST = 0.4
"""Largest mass that is learnt, positive or negative [kg]. Chosen; a weaker motor looks like a mass
too."""

_FELT = 0.5
"""Nothing is taken for a mass where a kilogram needs less torque than this [N m]."""

_JAW = 5


class Trim(ctypes.Structure):
    """Offsets of the six joints' goals against weight and friction; zero for the jaw.

    ``servo_trim.c`` computes them. Without ``per_kg``, the torque that each kilogram in the gripper
    adds, no such load is learnt.

    Attributes:
        carried: The estimated mass in the gripper [kg].
        lags: The uncompensated lag of each joint now [rad].
        weights: The torques that hold the joints where they will be when the last goal acts [N m].
        ways: Which way and how fully friction is overcome, -1 to 1.
        weaker: By what share each servo seems to be weaker than its model.
        rougher: By what share its friction seems to be greater.
        rest: The part of ``offset`` that weight, friction and these two do not explain [rad].
        later: By how much each joint comes later than a servo of its type would [s].
        zero: How much farther each joint seems to be than it is said to, by the weights [rad].
        models: The servos; ``put`` replaces one.
        at: Its address, for C.
        weighs_itself: Whether C knows the arm's weight, and need not be given its torques.
    """

    _fields_ = [
        *((name, ctypes.c_double) for name in ("engaging", "heaviest", "largest_drive")),
        *((name, ctypes.c_double) for name in ("settle_position", "left_alone")),
        *((name, ctypes.c_double) for name in ("carried", "since", "last", "has_goal")),
        *((name, SIX) for name in ("lags", "added_per_kg", "weights", "ways", "torque")),
        *((name, SIX) for name in ("without_speed", "known", "rest", "goal", "qd")),
        *(
            (name, SIX)
            for name in ("hurry", "arrived", "gives_way", "weight_rate", "weaker", "rougher")
        ),
        *((name, SIX) for name in ("later", "later_seen", "later_felt", "unfelt", "pace", "side")),
        *((name, ctypes.c_double) for name in ("is_planned", "room", "missed")),
        ("zero", SIX),
        ("by_angle", ctypes.c_double * 15),
        ("doubt", ctypes.c_double * 24**2),
        ("servo", ctypes.POINTER(ServoModel) * 6),
        ("arm", ctypes.POINTER(ArmWeight)),
    ]
    carried: float
    added_per_kg: Six
    weights: Six
    ways: Six
    rest: Six
    known: Six
    torque: Six
    weaker: Six
    later: Six
    zero: Six

    def __init__(self, gravity: Gravity, per_kg: Gravity | None = None) -> None:
        super().__init__(
            engaging=ENGAGING, heaviest=HEAVIEST, largest_drive=LARGEST_DRIVE,
            settle_position=SETTLE_POSITION, left_alone=LEFT_ALONE, missed=-math.inf,
        )  # fmt: skip
        self._gravity, self._load = gravity, per_kg
        self.weighs_itself = isinstance(gravity, ArmWeight) and per_kg is not None
        if isinstance(gravity, ArmWeight) and self.weighs_itself:
            self.arm = ctypes.pointer(gravity)
        self._in_c, self.at = quick(), ctypes.c_void_p(ctypes.addressof(self))
        self.models = [ServoModel() for _ in range(6)]
        for i, model in enumerate(self.models):
            self.put(i, model)

    def put(self, i: int, model: ServoModel) -> None:
        self.models[i], self.servo[i] = model, ctypes.pointer(model)
        self._in_c.so101_trim_forget(self.at, i)

    @property
    def full_drive_errors(self) -> list[float]:
        """The position error at which each servo drives fully [rad]."""
        return [model.full_drive_error for model in self.models]

    def explain(
        self,
        q: Sequence[float],
        way: Sequence[float],
        qd: Sequence[float],
        carried: Sequence[float],
    ) -> list[float]:
        """Offsets of the arm joints' goals [rad] at ``q`` [rad] and ``qd`` [rad/s].

        ``way`` is which way and how fully friction is overcome, -1 to 1, ``carried`` the mass in
        the gripper that each joint counts on [kg].
        """
        weights = [w + m * u for w, u, m in zip(self.own(q), self.per_kg(q), carried, strict=False)]
        return [
            limited(
                model.distance(weight + side * model.friction(weight, side), speed),
                model.error_for(LARGEST_SAG),
            )
            for model, weight, side, speed in zip(self.models, weights, way, qd, strict=False)
        ]

    def own(self, q: Sequence[float]) -> list[float]:
        """The torques that hold the six joints of the empty arm at ``q`` [rad], in [N m]."""
        own: list[float] = self._gravity(np.add(q, self.zero)).tolist()
        return own

    def per_kg(self, q: Sequence[float]) -> list[float]:
        """What each kilogram in the gripper adds to the six joints at ``q`` [rad], in [N m/kg]."""
        if self._load is None:
            return [0.0] * 6
        per_kg: list[float] = self._load(np.add(q, self.zero)).tolist()
        return per_kg

    def taken_for_mass(self) -> tuple[float, list[float]]:
        """Take as much as possible of what was learnt for a mass in the gripper.

        Returns that mass [kg], and what is left of the arm joints' offsets [rad].
        """
        arms, rest = self.added_per_kg[:_JAW], self.learnt[:_JAW]
        heaviness = sum(each * each for each in arms)
        if heaviness < _FELT**2:
            return self.carried, rest
        torques = [m.stiffness * off for m, off in zip(self.models, rest, strict=False)]
        more = sum(u * t for u, t in zip(arms, torques, strict=True)) / heaviness
        mass = limited(self.carried + more, HEAVIEST)
        left = [
            (torque - (mass - self.carried) * arm) / model.stiffness
            for torque, arm, model in zip(torques, arms, self.models, strict=False)
        ]
        return mass, left

    def drive(self, i: int) -> tuple[float, float, float, float]:
        """What joint ``i``'s servo can do, as far as is known.

        Returns:
            Its torque at rest [N m], its speed without torque [rad/s], the torque that friction
            takes without load [N m], and what lifts a load, as a share of the load.
        """
        servo, rough = self.models[i], 1.0 + self.rougher[i]
        kind = servo.kind
        driven = 1.0 - rough * kind.load_motor
        return (
            servo.volts * kind.torque_per_volt / (1.0 + self.weaker[i]),
            servo.volts / kind.back_emf,
            rough * kind.coulomb / driven,
            (1.0 + rough * kind.load_external) / driven,
        )

    @property
    def learnt(self) -> list[float]:
        """The part of ``offset`` that neither weight nor friction explain [rad]."""
        parts = zip(self.models, self.rest, self.weaker, self.torque, strict=True)
        return [off + w / (1.0 + w) * torque / m.stiffness for m, off, w, torque in parts]

    def in_play(self) -> list[int]:
        """The joints that may stand in their play now, with any load the gripper may carry.

        A joint stands still while its motor crosses the play: where a load that pulled it ahead of
        its motor falls away. Without such a load the motor drags the output; under a lasting one
        the output stays ahead of the motor.
        """
        found = self._in_c.so101_trim_in_play(self.at)
        return [i for i in range(_JAW) if found >> i & 1]

    @property
    def offset(self) -> list[float]:
        """The offsets to add to the six commanded positions [rad]."""
        return [known + rest for known, rest in zip(self.known, self.rest, strict=True)]

    def start(self, goal: list[float], now: float, sag: Sequence[float | None]) -> None:
        """Start with the six joints at rest at ``goal`` [rad] at ``now`` [s].

        The offset begins with ``sag``, the distance from there to the servo's goal [rad], as far as
        the weight can be the reason. That of a limp joint, None, begins with its weight alone: the
        servo carries it from the first moment, and a joint that lies on something stays there.
        """
        known = [math.nan if off is None else off for off in sag]
        given = (SIX(*each) for each in (goal, known, self.own(goal), self.per_kg(goal)))
        self._in_c.so101_trim_start(self.at, *given, ctypes.c_double(now))

    def measure(self, q: Six, qd: Six, fresh: int, now: float) -> None:
        """Learn from the angles [rad] and velocities [rad/s] of ``fresh`` joints at ``now`` [s].

        Angles and velocities are arrays of C; ``fresh`` has a bit for each joint.
        """
        self._in_c.so101_trim_measure(self.at, q, qd, fresh, now)
