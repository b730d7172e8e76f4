"""The real arm: up to six servos on a serial bus as one ``JointDriver``.

How it works. A control cycle is two transactions: a sync write of the goals, two bytes a servo, and
a sync read of the positions; ten times a second the read is longer and brings voltage, current,
temperature, load and faults as well. Speed and acceleration are capped in the servos' own
registers, so a setpoint that came late or wrong is still approached no faster than that.

*Nothing moves by being switched on.* While the servos are limp, ``write`` only remembers the goal;
``set_torque`` then writes it, reads it back, switches torque on and reads that back. The goal is
where the joint is, and so much beyond that the servo carries the joint's weight. A servo that
drives its joint already, because a former process left it so or the cable was out for a moment,
stands a little off its goal under its load; the first goal keeps exactly that distance.

*One silent servo costs nobody else anything.* For a few cycles its last position stands in. Then
``read`` raises ``NoReply`` once, which ends what is under way; after that the others are read as
before, and the silent one is asked along. When it answers again it is set up anew, and if it had
restarted it is made to hold where it is and ``ServoFault`` is raised once, because the joint may
stand elsewhere now.

*The port may go away.* ``read`` and ``write`` then raise ``PortUnavailable``; every later ``read``
tries to get it back (``connection.py``) and sets the servos up again. They hold meanwhile, and
nothing is written to them before somebody asks for it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from so101_motion.clock import Clock
from so101_motion.drivers import registers as reg
from so101_motion.drivers.bus import PATIENCE, Bus
from so101_motion.drivers.connection import Connection
from so101_motion.drivers.droop import Gravity, Trim
from so101_motion.drivers.health import VITALS_COUNT, VITALS_START, JointHealth, joint_health
from so101_motion.drivers.presence import Presence, not_there
from so101_motion.drivers.registers import Register
from so101_motion.drivers.sdk import Port
from so101_motion.drivers.servo_setup import ServoCondition, prepare
from so101_motion.drivers.slope import Slope
from so101_motion.drivers.ticks import JointMap, Ticks, to_acceleration_units, to_speed_ticks
from so101_motion.errors import BusError, CorruptReply, NoReply, PortUnavailable, ServoFault
from so101_motion.geometry import Array
from so101_motion.state import ARM_JOINTS, GRIPPER_JOINT, JointReading
from so101_motion.units import to_rad

JOINTS = (*ARM_JOINTS, GRIPPER_JOINT)
"""Base to jaw, the order of the servos along the cable."""

SETTLE_POSITION = to_rad(0.25)
"""How near to its goal a joint must come to have arrived [rad]: not quite three ticks, twice the
trim's dead band, so that with the tick's own width the joint truly is within 0.3 deg."""

SETTLE_VELOCITY = to_rad(3.0)
"""How slow a joint at rest is [rad/s]: its encoder was seen to scatter by 3 ticks."""

SETTLE_TIMEOUT = 2.0
"""How long settling may take [s]: ten time constants of the trim's integral."""

VITALS_PERIOD = 0.1
"""How often the long block is read [s]; makes the average cycle 1.07 times the shortest one."""

_REWRITE = 0.03
"""After how long without a setpoint the goals are sent again, with what the trim has learnt [s]."""


class FeetechArm:
    """Six Feetech servos, or as many as there are; fits ``JointDriver``.

    Args:
        open_port: Opens the serial port, e.g. a ``PortOpener``.
        clock: What time it is.
        maps: The servo of each joint this arm has, by joint name. A joint without one reads as 0
            and takes no goals.
        gravity: The torque that holds a pose, see ``droop.py``.
        speed: Speed cap kept by the servos themselves [rad/s].
        acceleration: Acceleration cap kept by the servos themselves [rad/s^2]; well above what
            is planned, or the servos lag behind.
        patience: How long to wait for an answer beyond the time on the wire [s].

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
        speed: float,
        acceleration: float,
        patience: float = PATIENCE,
    ) -> None:
        self._clock = clock
        self._maps = {JOINTS.index(joint): maps[joint] for joint in JOINTS if joint in maps}
        self._index = {joint.servo_id: i for i, joint in self._maps.items()}
        if len(self._index) != len(maps):
            raise ValueError(f"each joint needs a servo of its own: {dict(maps)}")
        self._ram = dict.fromkeys(self._index, _caps(speed, acceleration))
        names = {servo_id: JOINTS[i] for servo_id, i in self._index.items()}
        self._connection = Connection(open_port, clock, names=names, patience=patience)
        self._presence = Presence(tuple(self._index))
        self._greeted = self._torque = self._aimed = False
        # Six numbers each, in plain lists: for so few they beat numpy in every cycle.
        self._q, self._qd, self._goal = [0.0] * 6, [0.0] * 6, [0.0] * 6
        self._held: list[float | None] = [None] * 6  # the servos' goals [rad]; None while limp
        self._slope, self._trim = Slope(6), Trim(gravity)
        self._vitals: dict[int, tuple[float, bytes]] = {}
        self._vitals_due = self._written = clock.now()
        try:
            self._reach()
        except BusError:
            self._connection.close()
            raise

    # What a driver does

    def read(self) -> JointReading:
        """Measure all joints; takes up the connection again if it was lost.

        Raises:
            PortUnavailable: There is no port at present.
            NoReply: A servo has fallen silent (raised once), or all are.
            ServoFault: A servo has restarted by itself (raised once).
        """
        with self._watching():
            bus = self._reach()
            self._measure(bus)
            if self._aimed and self._torque and self._clock.now() - self._written >= _REWRITE:
                self._send(bus)
        q, qd = self._q, self._qd
        return JointReading(q=np.array(q[:5]), qd=np.array(qd[:5]), q_jaw=q[5], qd_jaw=qd[5])

    def write(self, q_cmd: Array, q_jaw_cmd: float) -> None:
        """Send the joints to ``q_cmd``, shape (5,), and the jaw to ``q_jaw_cmd`` [rad].

        Raises:
            PortUnavailable: There is no port at present.
        """
        with self._watching():
            bus = self._in_use()
            self._aim([*q_cmd.tolist(), q_jaw_cmd])
            if self._torque:
                self._send(bus)

    def set_torque(self, on: bool) -> None:
        """Hold the joints at the goal written last, or let go of them.

        A silent jaw is left out; without one of its joints the arm is not switched on.

        Raises:
            BusError: A servo did not obey. Letting go is tried with all of them first.
        """
        with self._watching():
            bus = self._in_use()
            if on:
                self._switch_on(bus)
            else:
                self._switch_off(bus)

    def close(self) -> None:
        """Let go of the port; the servos stay as they are."""
        self._connection.close()

    # What else can be asked of this arm, on the I/O thread

    @property
    def bus(self) -> Bus:
        """The bus, for jobs that talk to the servos themselves.

        Raises:
            PortUnavailable: There is no port at present.
        """
        return self._in_use()

    def set_caps(self, *, speed: float, acceleration: float) -> None:
        """Change the caps the servos keep [rad/s], [rad/s^2], for good.

        Raises:
            BusError: A servo did not take them.
        """
        self._put(dict.fromkeys(self._index, _caps(speed, acceleration)))

    def set_torque_limit(self, joint: str, share: float) -> None:
        """Let ``joint`` use at most ``share``, 0 to 1, of its motor's drive, also after a restart.

        Raises:
            BusError: The servo did not take it.
        """
        servo_id = self._maps[JOINTS.index(joint)].servo_id
        self._put({servo_id: {reg.TORQUE_LIMIT: round(1000.0 * min(max(share, 0.0), 1.0))}})

    # What any thread may ask

    @property
    def health(self) -> tuple[JointHealth, ...]:
        """How each servo was when it was last looked at, base to jaw; newest tenth of a second."""
        vitals, silent, tallies = self._vitals, self._presence.silent, self._connection.tallies
        return tuple(
            joint_health(
                JOINTS[i],
                servo_id,
                *vitals[servo_id],
                tallies[servo_id],
                is_silent=servo_id in silent or not self.is_connected,
            )
            for servo_id, i in self._index.items()
            if servo_id in vitals
        )

    @property
    def is_connected(self) -> bool:
        """Whether the port is open and the servos have been found."""
        return self._greeted

    @property
    def port_losses(self) -> int:
        """How often the port went away since the start."""
        return self._connection.losses

    # Connecting

    @contextlib.contextmanager
    def _watching(self) -> Iterator[None]:
        """Notice here that the port went away."""
        try:
            yield
        except PortUnavailable as error:
            if self._connection.is_open:
                self._connection.lost(error)
            self._aimed = self._greeted = False
            raise

    def _reach(self) -> Bus:
        bus = self._connection.bus()
        if not self._greeted:
            self._greet(bus)
            self._greeted = True
        return bus

    def _in_use(self) -> Bus:
        if not self._greeted:
            reason = "not connected at present; the connection is taken up again by itself"
            raise PortUnavailable("the arm's port", reason)
        return self._connection.bus()

    def _greet(self, bus: Bus) -> None:
        """Find the servos and set them up; those that are driven go on as they are."""
        self._aimed = False
        ids = tuple(self._index)
        found = bus.answering(ids)
        missing = [i for i in ids if i not in found and i not in self._presence.silent]
        if missing or not found:
            raise not_there(bus, missing or ids, found)
        self._presence.restart(found)
        self._torque = all([self._take_over(bus, servo_id).torque for servo_id in found])
        self._slope.clear()

    def _take_over(self, bus: Bus, servo_id: int) -> ServoCondition:
        """Set one servo up and learn how it stands."""
        i = self._index[servo_id]
        joint = self._maps[i]
        condition = prepare(bus, joint, self._ram[servo_id])
        self._q[i] = joint.to_rad(condition.present_ticks)
        self._held[i] = joint.to_rad(condition.goal_ticks) if condition.torque else None
        if i < 5:
            self._trim.set_gain(i, condition.p_gain)
        return condition

    def _take_back(self, bus: Bus, servo_ids: Sequence[int]) -> None:
        """Servos that were silent answer again; all are seen to before anything is raised."""
        restarted: list[int] = []
        refusals: list[ServoFault] = []
        for servo_id in servo_ids:
            try:
                condition = self._take_over(bus, servo_id)
                if self._torque and not condition.torque:
                    self._aimed = False
                    restarted.append(servo_id)
                    self._engage(bus, servo_id, condition.present_ticks)
                    self._held[self._index[servo_id]] = self._q[self._index[servo_id]]
            except (NoReply, CorruptReply):
                self._presence.dismiss(servo_id)  # not yet; it is tried again when it answers
            except ServoFault as error:
                refusals.append(error)
        if refusals:
            raise refusals[0]
        if restarted:
            names = ", ".join(bus.label(servo_id) for servo_id in restarted)
            raise ServoFault(
                f"{names} restarted and holds where it is now; its power must have failed: check"
                " its cable and the supply, then let the arm hold again",
                servo_id=restarted[0],
            )

    # Measuring

    def _measure(self, bus: Bus) -> None:
        now, position = self._clock.now(), reg.PRESENT_POSITION
        has_vitals = now >= self._vitals_due
        found = bus.sync_read(
            tuple(self._index),
            VITALS_START,
            VITALS_COUNT if has_vitals else position.size,
            tries=2,
            given_up=self._presence.silent,
        )
        for servo_id, answer in found.items():
            i = self._index[servo_id]
            ticks = position.decode(answer.data[: position.size])
            self._q[i] = self._maps[i].to_rad(Ticks(ticks))
        self._slope.add(now, self._q)
        self._qd = self._slope.value()
        if self._aimed and self._torque:
            fresh = [self._index[servo_id] for servo_id in found]
            self._trim.measure(self._q, self._qd, fresh, now)
        if has_vitals:
            self._vitals_due = now + VITALS_PERIOD
            self._vitals = self._vitals | {i: (now, answer.data) for i, answer in found.items()}
        change = self._presence.judge(found)
        if change.fallen or self._presence.all_silent:
            self._aimed = False
            raise not_there(bus, change.fallen or tuple(self._index), found)
        self._take_back(bus, change.back)

    # Commanding

    def _aim(self, goal: list[float]) -> None:
        now, was_aimed = self._clock.now(), self._aimed
        self._goal, self._aimed = goal, True
        if was_aimed:
            self._trim.command(goal, now)
        else:
            off = zip(self._held, goal, strict=True)
            self._trim.start(goal, now, [None if held is None else held - q for held, q in off])

    def _goal_ticks(self) -> dict[int, Ticks]:
        """Goals of the servos that answer, by id."""
        silent, offset = self._presence.silent, self._trim.offset
        goals = {}
        for servo_id, i in self._index.items():
            if servo_id not in silent:
                self._held[i] = wanted = self._goal[i] + offset[i]
                goals[servo_id] = self._maps[i].to_goal(wanted)
        return goals

    def _send(self, bus: Bus) -> None:
        self._written = self._clock.now()
        encode = reg.GOAL_POSITION.encode
        data = {servo_id: encode(goal) for servo_id, goal in self._goal_ticks().items()}
        bus.sync_write(reg.GOAL_POSITION.address, data)

    @staticmethod
    def _engage(bus: Bus, servo_id: int, goal: int) -> None:
        bus.write(servo_id, reg.GOAL_POSITION, goal)
        bus.write(servo_id, reg.TORQUE_ENABLE, 1)

    def _switch_on(self, bus: Bus) -> None:
        if not self._aimed:
            raise RuntimeError("write a goal before torque is switched on")
        lost = sorted(i for i in self._presence.silent if self._index[i] < 5)
        if lost:
            raise not_there(bus, lost, set(self._index) - self._presence.silent)
        for servo_id, goal in self._goal_ticks().items():
            self._engage(bus, servo_id, goal)
        self._torque = True

    def _switch_off(self, bus: Bus) -> None:
        self._torque = self._aimed = False
        self._held = [None] * 6
        failures: list[BusError] = []
        for servo_id in self._index.keys() - self._presence.silent:
            try:
                bus.write(servo_id, reg.TORQUE_ENABLE, 0)
            except PortUnavailable:
                raise
            except BusError as error:
                failures.append(error)
        if failures:
            raise failures[0]

    def _put(self, values: Mapping[int, dict[Register, int]]) -> None:
        with self._watching():
            bus = self._in_use()
            for servo_id, ram in values.items():
                self._ram[servo_id] = self._ram[servo_id] | ram
                if servo_id not in self._presence.silent:
                    for register, value in ram.items():
                        bus.write(servo_id, register, value)


def _caps(speed: float, acceleration: float) -> dict[Register, int]:
    return {
        reg.ACCELERATION: to_acceleration_units(acceleration),
        reg.GOAL_VELOCITY: to_speed_ticks(speed),
    }
