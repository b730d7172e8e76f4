"""Drive the real arm: up to six servos on a serial bus as one ``JointDriver``.

A control cycle is two transactions: a sync write of the goals and a sync read of the positions; ten
times a second the read also brings voltage, current, temperature, load and faults.

*Switching torque on moves nothing.* While the servos are limp, ``write`` only remembers the goal;
``set_torque`` then writes it, reads it back, switches torque on and reads that back. The goal is
the joint's position plus the offset with which the servo carries the joint's weight. A servo that
already drives its joint, because an earlier process left it so or the cable was out for a moment,
stands a little off its goal under its load; the first goal keeps exactly that distance.

*One silent servo does not disturb the others*, and no lost answer is asked for twice in a cycle:
the next cycle comes soon. For a quarter of a second a joint without an answer is assumed to follow
its goals (``joint_estimate.py``), for half a second if all are silent. Then ``read`` raises
``NoReply`` once, which ends the motion; after that the others are read as before. When the servo
answers again it is set up anew; one that had restarted is made to hold where it is, and
``ServoFault`` is raised once.

*The port may go away.* Every ``read`` then tries to reopen it and sets the servos up again. They
hold meanwhile, and get no new goal before somebody asks for one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache

from so101_motion.common.clock import Clock
from so101_motion.common.compliance import Compliance, Wall
from so101_motion.common.errors import BusError, PortUnavailable, ServoFault
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT, JointReading
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import REPLY_TIMEOUT, Bus, Port
from so101_motion.drivers.bus.protocol import Answer
from so101_motion.drivers.bus.registers import LET_GO
from so101_motion.drivers.bus.reply_counters import ReplyCounters
from so101_motion.drivers.bus.ticks import JointMap, to_acceleration_units, to_speed_ticks
from so101_motion.drivers.command_record import CommandListener
from so101_motion.drivers.feetech.chain import Chain
from so101_motion.drivers.feetech.goal_compensation import LIMP, GoalCompensation
from so101_motion.drivers.feetech.gravity_compensation import Gravity
from so101_motion.drivers.feetech.hand_guiding import HandGuiding
from so101_motion.drivers.feetech.hand_pull import HandPull, Pull
from so101_motion.drivers.feetech.health import HealthReadings, JointHealth
from so101_motion.drivers.feetech.presence import missing_servos, restarted_servos
from so101_motion.drivers.feetech.servo_model import ServoModel
from so101_motion.drivers.goal_limiter import SIX, CArray, GoalLimiter, as_bits
from so101_motion.drivers.servo_types import ServoFigures

JOINTS = (*ARM_JOINTS, GRIPPER_JOINT)
"""Base to jaw, the order of the servos along the cable."""

_NO_GOALS: CArray = SIX(*[math.nan] * 6)
_NONE: frozenset[str] = frozenset()
_NOTHING: Mapping[str, float] = {}
_ALL = 0b111111

_REWRITE = 0.03
"""How long after the last setpoint the goals of a resting arm are sent again, with the trim [s]."""


@lru_cache
def _named(joints: int) -> frozenset[str]:
    """The joints whose bits are set."""
    return frozenset(joint for i, joint in enumerate(JOINTS) if joints >> i & 1)


class _Measured(JointReading):
    """A reading whose arrays nobody can write, so they need not be copied."""

    __slots__ = ()

    def __post_init__(self) -> None:
        pass


class FeetechArm:
    """Six Feetech servos, or as many as there are; fits ``JointDriver``.

    Args:
        open_port: Opens the serial port, e.g. a ``PortOpener``.
        clock: What time it is.
        maps: The servo of each joint this arm has, by joint name. A joint without one reads as 0
            and takes no goals.
        gravity: The torque that holds a pose, see ``gravity_compensation.py``.
        per_kg: Additional torque for each kilogram in the hand; None if unknown.
        speed: Speed cap kept by the servos themselves [rad/s].
        acceleration: Acceleration cap of the servos [rad/s^2]; well above plans, or they lag.
        reply_timeout: See ``Bus``; ``counters``, too.
        figures: How servos were found to differ from their type, by joint name.
        compensates: Whether goals compensate weight, friction and lag.

    Raises:
        BusError: The port cannot be opened, or a servo cannot be reached or set up.
        ValueError: A name is no joint, or two joints have the same servo.
    """

    def __init__(
        self,
        open_port: Callable[[], Port],
        clock: Clock,
        maps: Mapping[str, JointMap],
        *,
        gravity: Gravity,
        per_kg: Gravity | None = None,
        speed: float,
        acceleration: float,
        reply_timeout: float = REPLY_TIMEOUT,
        counters: ReplyCounters | None = None,
        figures: Mapping[str, ServoFigures] | None = None,
        compensates: bool = True,
    ) -> None:
        self._clock = clock
        self._maps = {JOINTS.index(joint): maps[joint] for joint in JOINTS if joint in maps}
        self._absent = frozenset(JOINTS) - maps.keys()
        caps = to_acceleration_units(acceleration), to_speed_ticks(speed)
        ram = dict(zip((reg.ACCELERATION, reg.GOAL_VELOCITY), caps, strict=True))
        limiter = GoalLimiter(JOINTS, speed=speed, acceleration=acceleration)
        known = {JOINTS.index(joint): each for joint, each in (figures or {}).items()}
        self._compensation = GoalCompensation(
            self._maps, gravity, limiter, per_kg, known, compensates=compensates)  # fmt: skip
        self.trim = self._compensation.trim
        self.models: Sequence[ServoModel] = self.trim.models
        self._chain = Chain(
            open_port, clock, self._maps, self._compensation, names=JOINTS, ram=ram,
            reply_timeout=reply_timeout, counters=counters,
        )  # fmt: skip
        self._index, self._presence = self._chain.index, self._chain.presence
        self._at, self._out_of_range = self._chain.at, self._chain.out_of_range
        self._measured, self._sure = (self._at.q, self._at.qd), self._at.sure  # they last
        if len(self._index) != len(maps):
            raise ValueError(f"each joint needs a servo of its own: {dict(maps)}")
        self._torque = False
        self._guide: HandGuiding | None = None
        self._pull = HandPull(self._chain, self._compensation, clock)
        self._health_readings = HealthReadings(clock.now())
        try:
            self._reach()
        except BusError:
            self._chain.connection.close()
            raise

    # What a driver does

    def read(self) -> JointReading:
        """Measure all joints; takes up the connection again if it was lost.

        Raises:
            PortUnavailable: There is no port at present.
            NoReply: A servo has fallen silent (raised once), or all are.
            ServoFault: A servo has restarted by itself (raised once).
        """
        at, chain, presence, unanswered = self._at, self._chain, self._presence, _NONE
        try:
            bus = chain.bus() if chain.is_set_up else self._reach()
            is_plain = self._measure(bus)
            if self._guide is not None:
                chain.lead(*self._guide.step(at.q, at.qd, self._clock.now()))
            elif self._pull.pull is not None:
                self._pull.step()
            elif self._clock.now() - chain.t_sent >= _REWRITE and self._is_held:
                chain.send(bus)
        except PortUnavailable as error:
            chain.lost(error)
            raise
        unsure, silent, outside = at.unsure, self._absent, self._out_of_range
        if not is_plain:
            unanswered = _named(self._bits(presence.unanswering))
            unsure &= ~self._bits(presence.silent)  # they are no surer than their last answers
            silent = silent | _named(self._bits(presence.silent))
        in_play, held = self._compensation.in_play()
        q, qd = at.arrays()
        return _Measured(
            q=q,
            qd=qd,
            q_jaw=self._measured[0][5],
            qd_jaw=self._measured[1][5],
            driven=None if held == _ALL else _named(held),
            out_of_range={JOINTS[i]: q_in for i, q_in in outside.nearest(at.q).items()}
            if outside
            else _NOTHING,
            unanswered=unanswered,
            silent=silent,
            unconfirmed=_named(unsure),
            in_play={JOINTS[i]: off for i, off in in_play.items()} if in_play else _NOTHING,
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
        """Send the joints to ``q_cmd``, shape (5,), and the jaw to ``q_jaw_cmd`` [rad].

        While the arm is guided only the jaw is commanded.

        Args:
            q_cmd: Angles of the arm joints now.
            q_jaw_cmd: Angle of the jaw.
            qd_cmd: Velocities of the arm joints there, shape (5,), [rad/s]; None for at rest.
            qdd_cmd: Accelerations there, shape (5,), [rad/s^2]; None if not known.
            follows_target: Whether the motion follows a target and is not planned, so that a joint
                may turn round at any moment.
            room: By which share all may be faster now without being faster than planned soon.

            Raises: CommandRefused: It is further away than the caps allow; the joints hold the last
            command. NoReply: The position of a joint that is to be held is not confirmed.
        """
        try:
            bus, now, compensation = self._chain.bus(), self._clock.now(), self._compensation
            here, outside = self._sure, self._out_of_range
            free = outside.free if (is_outside := bool(outside)) else ()
            if self._guide is not None:
                compensation.point([*compensation.q[:5], q_jaw_cmd], None, now, here, free)
                return
            q = [*q_cmd.tolist(), q_jaw_cmd]
            if self._is_held:
                if qd_cmd is None:  # a new goal without a velocity: hold the joint where it is
                    self._chain.refuse_unsure([i for i in self._maps if q[i] != compensation.q[i]])
                qd = None if qd_cmd is None else qd_cmd.tolist()
                qdd = None if qdd_cmd is None else qdd_cmd.tolist()
                compensation.trim.room = room
                compensation.point(q, qd, now, here, free, qdd, follows_target=follows_target)
            else:
                self._pull.end()
                self._chain.refuse_unsure(self._maps)
                compensation.begin(q, self._at.q, now, free)
            if self._torque:
                if is_outside:
                    goals = compensation.goals(now, self._presence.silent)
                    for i in outside.lead(bus, compensation.q, goals):
                        compensation.held[i] = self._at.ticks(i)
                self._chain.send(bus)
        except PortUnavailable as error:
            self._chain.lost(error)
            raise

    def set_torque(self, on: bool) -> None:
        """Switch torque on at the last written goal, or switch it off.

        A joint outside its limits and a silent jaw are left as they are; if another servo is
        silent, the arm is not switched on. Off, all servos are tried before an error is raised.
        """
        with self._chain:
            bus = self._chain.bus()
            if on:
                self._end_guiding(bus)
                self._pull.end()
                self._chain.switch_on()
                self._torque = True
                return
            guide, self._guide, self._torque = self._guide, None, False
            try:
                self._pull.end()
            finally:
                self._chain.switch_off()
                if guide is not None:
                    self._chain.limit_again()

    def guide(self, compliance: Compliance | None, wall: Wall | None = None) -> None:
        """Let the joints of the arm, which must be held, yield to a hand; the jaw holds on.

        ``read`` has to be called a hundred times a second then. Only RAM registers are written.
        Without a ``compliance`` it ends, and they hold where they are. ``wall`` says how far a hand
        may lead them without resistance; None for anywhere.
        """
        with self._chain:
            bus = self._chain.bus()
            if compliance is None:
                self._end_guiding(bus)
            elif not self._is_held:
                raise RuntimeError("hold the joints before they are guided")
            else:
                self._chain.refuse_unsure(self._maps)
                trim, now = self._compensation.trim, self._clock.now()
                self._guide = HandGuiding(compliance, trim, self._at.q, now, wall)

    def pull(self, pull: Pull) -> None:
        """Pull the limp joints of the arm softly; see ``hand_pull.py``.

        ``read`` has to be called a hundred times a second then. Only RAM registers are written.
        """
        with self._chain:
            if self._torque:
                raise RuntimeError("joints that are held are not pulled; let go of them first")
            self._chain.bus()
            self._pull.ask(pull)

    def close(self) -> None:
        """End a pull and close the port; the servos stay as they are."""
        if self._chain.is_set_up:
            with suppress(BusError):
                self._pull.end()
        self._chain.connection.close()

    # What else can be asked of this arm, on the I/O thread

    @property
    def bus(self) -> Bus:
        """The bus, for jobs that talk to the servos; ``PortUnavailable`` if there is none."""
        return self._chain.bus()

    def set_torque_limit(self, joint: str, share: float) -> None:
        """Limit the drive of ``joint`` to ``share``, 0 to 1, also after a restart."""
        i, share = JOINTS.index(joint), min(max(share, 0.0), 1.0)
        with self._chain:
            self._chain.bus()
            self._chain.put(self._maps[i].servo_id, reg.TORQUE_LIMIT, round(1000.0 * share))
        self.models[i].most_drive = share

    @property
    def on_command(self) -> CommandListener | None:
        return self._chain.on_command

    @on_command.setter
    def on_command(self, listener: CommandListener | None) -> None:
        self._chain.on_command = listener

    # What any thread may ask

    @property
    def health(self) -> tuple[JointHealth, ...]:
        """The health figures of each servo, base to jaw, at most 0.1 s older than the positions."""
        names = {servo_id: JOINTS[i] for servo_id, i in self._index.items()}
        silent = self._presence.silent if self.is_connected else names
        return self._health_readings.health(names, self._chain.connection.counters, silent)

    @property
    def is_connected(self) -> bool:
        return self._chain.is_set_up

    @property
    def is_driving(self) -> bool:
        return any(held != LIMP for held in self._compensation.held)

    @property
    def limp(self) -> tuple[str, ...]:
        return tuple(JOINTS[i] for i in self._index.values() if self._compensation.held[i] == LIMP)

    @property
    def port_losses(self) -> int:
        return self._chain.connection.losses

    # Connecting

    def _reach(self) -> Bus:
        if not self._chain.is_set_up:
            self._compensation.is_set, self._guide = False, None
            self._torque = self._chain.set_up() and not self._pull.is_on
            self._at.forget()
            self._pull.end()
        return self._chain.bus()

    def _take_back(self, bus: Bus, servo_ids: Sequence[int]) -> None:
        """Set up servos that answer again and make restarted ones hold; errors are raised last."""
        limp, refusals = self._chain.set_up_again(servo_ids)
        self._pull.end()
        restarted = limp if self._torque else []
        for servo_id in restarted:
            self._compensation.is_set = False
            try:
                self._chain.catch(self._index[servo_id])
            except ServoFault as error:
                refusals.append(error)
        if refusals:
            raise refusals[0]
        if restarted:
            raise restarted_servos(bus, restarted)

    # Measuring

    def _measure(self, bus: Bus) -> bool:
        """Update the estimate, the compensation and who answers.

        Returns whether all servos have answered, as before, and have nothing special to say.
        """
        now, presence, compensation = self._clock.now(), self._presence, self._compensation
        outside, missed = self._out_of_range, presence.unanswering
        count, is_held = self._health_readings.count(now), self._torque and compensation.is_set
        wanted, learning, plainly = _NO_GOALS, None, None
        if is_held and self._guide is None:
            wanted, learning = compensation.q, compensation.trim.at
        elif is_held:
            wanted = SIX(*_NO_GOALS[:5], compensation.q[5])
        if not (missed or compensation.weak or outside or outside.sinking):
            plainly = wanted, learning
        found, doubted = self._at.ask(bus, count, missed, self._clock, plainly=plainly)
        if doubted is None:
            if found:
                self._take_vitals(found, now)
            return True
        self._at.look(wanted, now)
        watched = compensation.weak or outside.sinking
        if watched or any(answer.faults for answer in found.values()):
            self._note_faults(bus, found, is_held=is_held)
        if learning is not None:
            if outside:
                outside.arrive(bus, self._at.q)
            fresh = self._at.fresh & ~as_bits(outside.left | compensation.weak)
            compensation.trim.measure(*self._measured, fresh, now)
        self._take_vitals(found, now)
        fallen, back = presence.judge(found, now)
        if fallen or presence.all_silent:
            compensation.is_set = False
            raise missing_servos(bus, fallen or tuple(self._index), found, doubted)
        if back:
            self._take_back(bus, back)
            if presence.silent and not compensation.is_set:  # what was told of more servos is over
                raise missing_servos(bus, sorted(presence.silent), found, doubted)
        return False

    def _take_vitals(self, found: Mapping[int, Answer], now: float) -> None:
        for servo_id, volts in self._health_readings.take(now, found).items():
            self._compensation.supplied(self._index[servo_id], volts)

    def _note_faults(self, bus: Bus, found: Mapping[int, Answer], *, is_held: bool) -> None:
        for servo_id, answer in found.items():
            i = self._index[servo_id]
            self._compensation.heard(i, answer.faults)
            if is_held and self._compensation.held[i] != LIMP:
                has_let_go = bool(answer.faults & LET_GO)
                if self._out_of_range.sank(bus, i, self._at.ticks(i), has_let_go=has_let_go):
                    self._compensation.held[i] = self._at.ticks(i)

    def _bits(self, servo_ids: Iterable[int]) -> int:
        return as_bits([self._index[servo_id] for servo_id in servo_ids])

    @property
    def _is_held(self) -> bool:
        return self._torque and self._compensation.is_set

    def _end_guiding(self, bus: Bus) -> None:
        """End guiding: hold the joints where they are, then restore their torque limits."""
        guide, self._guide = self._guide, None
        if guide is None:
            return
        here = [*self._at.q[:5], self._compensation.q[5]]
        self._compensation.begin(here, here, self._clock.now(), ())
        for i, ticks in self._out_of_range.stop(bus, self._at, self._presence.silent).items():
            self._compensation.held[i] = ticks
        self._chain.send(bus)
        self._chain.limit_again()
