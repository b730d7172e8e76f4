"""The emulated arm: servos, bus, port and faults put together.

Tests run an ``Emulator`` in their own process; the command line runs one in its own (``run.py``). A
test that needs a lost reply or a hot servo calls ``begin`` with a fault; there is nothing to patch.

The two scripts here are for ``hand.py``. The hand carries the weight of the joint it leads, and
presses against a stop with little more than that: a stop gives way under more, and a calibration
would record it too far out.
"""

from __future__ import annotations

import math
import random
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import ClassVar, Protocol, Self

import numpy as np

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.bus import Bus
from so101_motion.drivers.emulator.electric import Supply
from so101_motion.drivers.emulator.faults import FaultEvent, WireFaults
from so101_motion.drivers.emulator.hand import STIFFNESS, Hand, parse_script
from so101_motion.drivers.emulator.joint_figures import JOINTS, SO101, Joint
from so101_motion.drivers.emulator.pty_port import Pacing, PtyPort
from so101_motion.drivers.emulator.servo import Servo
from so101_motion.drivers.emulator.world import Gravity, World, no_gravity
from so101_motion.drivers.servo_types import STS3215_12V, ServoFigures, ServoType
from so101_motion.drivers.things import Things

SPEED = math.radians(120.0)
"""Speed at which the hand leads a joint [rad/s]; chosen, a person is slower."""

REST = 0.3
"""How long the hand stays at a stop [s]; chosen."""

_PRESS = 2.0 * STS3215_12V.break_away
"""Torque of the hand against a stop [N m]; chosen: enough to reach it, not enough to push it in."""

_START = 2.0
"""When the hand begins to sweep [s]; from half that time on it holds the pose. Chosen."""

UPRIGHT = {"wrist_roll": 0.0486795}
"""Roll angle at which the gripper opens straight upwards [rad]: the robot description mounts it 2.8
deg off."""


def holding_script(
    weight: Callable[[Array], Array], *, by: float, pose: Mapping[str, float] | None = None
) -> str:
    """A script in which the hand moves the arm to a pose and holds it there.

    ``weight`` is as in ``World``, ``by`` when the arm reaches the pose [s]. Joints [rad] that
    ``pose`` leaves out are as in ``UPRIGHT``, else zero.
    """
    lines = [f"0 {joint} start" for joint in JOINTS]
    lines += [_line(weight, by, i, _angles(pose)) for i in range(len(JOINTS))]
    return "\n".join(lines)


def sweeping_script(
    weight: Callable[[Array], Array],
    *,
    pose: Mapping[str, float] | None = None,
    speed: float = SPEED,
) -> tuple[str, float]:
    """A script in which the hand moves the arm to a pose and then sweeps the joints, base to jaw.

    ``weight`` and ``pose`` as in ``holding_script``, ``speed`` [rad/s]. Also returns when it is
    over [s].
    """
    held = _angles(pose)

    def line(t: float, i: int, q: Array, press: float = 0.0) -> str:
        return _line(weight, t, i, q, press)

    lines = [holding_script(weight, by=_START / 2.0, pose=pose)]
    t = _START
    for i, joint in enumerate(SO101):
        lines.append(line(t, i, held))
        q = held.copy()
        for there, press in ((joint.lower, -_PRESS), (joint.upper, _PRESS), (held[i], 0.0)):
            t += abs(there - q[i]) / speed
            q[i] = there
            lines += [line(t, i, q, press), line(t + REST, i, q, press)]
            t += REST
    return "\n".join(lines) + "\n", t


def _angles(pose: Mapping[str, float] | None) -> Array:
    wanted = {**UPRIGHT, **(pose or {})}
    return np.array([wanted.get(joint, 0.0) for joint in JOINTS])


def _line(weight: Callable[[Array], Array], t: float, i: int, q: Array, press: float = 0.0) -> str:
    aim = q[i] + (press + float(weight(q)[i])) / STIFFNESS
    return f"{t:.3f} {JOINTS[i]} {math.degrees(aim):.4f}"


_ZERO_TICKS = 100.0
"""Largest shift of a zero with a spread of 1 [tick]; chosen, a spread of 0.2 gives 1.8 deg."""


def differing_servos(
    joints: Sequence[Joint], kind: ServoType, *, spread: float, seed: int
) -> Iterator[tuple[Joint, ServoType]]:
    """Vary friction, play, torque, dead time and zero of each joint and its servo.

    ``spread`` is the largest deviation of each figure, as a share of it. The same seed makes the
    same arm.
    """
    rng = random.Random(seed)

    def factor() -> float:
        return 1.0 + rng.uniform(-spread, spread)

    for joint in joints:
        friction, dead_time, torque = factor(), factor(), factor()
        zero = joint.zero_ticks + round(_ZERO_TICKS * rng.uniform(-spread, spread))
        own = ServoFigures(
            torque=torque, friction=friction, dead_time=dead_time, play=kind.play * factor()
        )
        yield replace(joint, zero_ticks=zero), own.of(kind)


ALL_IDS: Mapping[int, int] = {place: place for place in range(1, 7)}
"""A finished arm: ids 1 to 6 from the base to the gripper."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EmulatorOptions:
    """Settings of an emulated arm."""

    link: Path | None = None  # a symbolic link that always leads to the port; None for none
    # servo id by place on the cable (1 base .. 6 gripper); places left out are unplugged
    ids: Mapping[int, int] = field(default_factory=lambda: dict(ALL_IDS))
    joints: tuple[Joint, ...] = SO101  # the joints with their servos' mounting
    kind: ServoType = STS3215_12V  # the type of the servos
    # how much the servos differ from each other, ``differing_servos``; 0 for none
    spread: float = 0.0
    seed: int = 0  # seed of these differences
    # how servos differ from their type, by joint, instead of at random
    figures: Mapping[str, ServoFigures] = field(default_factory=dict)
    volts: float | None = None  # supply voltage [V]; None for the servo's rated voltage
    q_start: tuple[float, ...] = (0.0,) * 6  # joint angles at the start, shape (6,), [rad]
    loose: bool = False  # whether no servo is on the cable at the start, whatever their ids
    # whether limits are stored in the servos, or they are as new (0 to 4095)
    calibrated: bool = True
    goal_enables_torque: bool = True  # whether writing a goal switches torque on
    dither: int = 0  # how far readings of a resting joint scatter [tick]; 3 on the measured arm
    pacing: Pacing = field(default_factory=Pacing)  # wire time and adapter latency
    wire: WireFaults = field(default_factory=WireFaults)  # disturbed replies
    faults: tuple[FaultEvent, ...] = ()  # timed faults
    hand: str = ""  # a hand script, see ``hand.py``


def parse_ids(text: str) -> dict[int, int]:
    """Read which places of the cable carry which ids: ``1-6``, ``1-3,5``, ``6=1``.

    Raises:
        ConfigError: It is not such a list.
    """
    ids: dict[int, int] = {}
    for part in text.split(","):
        form = re.fullmatch(r"\s*([1-6])(?:-([1-6])|=(\d{1,3}))?\s*", part)
        if form is None or int(form[3] or 0) > 253:
            reason = "must list places 1 to 6, as in 1-6 or 1-3,5 or 6=1 (place 6 with id 1)"
            raise ConfigError("ids", text, reason)
        first, last = int(form[1]), int(form[2] or form[1])
        ids.update({place: int(form[3] or place) for place in range(first, last + 1)})
    return ids


def build_world(
    options: EmulatorOptions,
    *,
    t: float = 0.0,
    gravity: Gravity = no_gravity,
    things: Things | None = None,
) -> World:
    """Build servos and supply without a port at time ``t`` [s]; the others as in ``World``."""
    servos = []
    differing = differing_servos(
        options.joints, options.kind, spread=options.spread, seed=options.seed
    )
    for place, ((joint, kind), q) in enumerate(
        zip(differing, options.q_start, strict=True), start=1
    ):
        if joint.name in options.figures:
            kind = options.figures[joint.name].of(options.kind)
        factory = {
            reg.ID: options.ids.get(place, place),
            reg.MAX_VOLTAGE: options.kind.max_voltage_raw,
        }
        servo = Servo(
            joint, kind, q=q, factory=factory,
            goal_enables_torque=options.goal_enables_torque, dither=options.dither,
        )  # fmt: skip
        if options.calibrated:
            ends = sorted(servo.drive.to_ticks(stop) for stop in (joint.lower, joint.upper))
            servo.memory.keep(reg.MIN_POSITION, max(round(ends[0]), 0))
            servo.memory.keep(reg.MAX_POSITION, min(round(ends[1]), 4095))
        servo.connected = place in options.ids and not options.loose
        servos.append(servo)
    volts = options.kind.volts if options.volts is None else options.volts
    return World(servos, t=t, gravity=gravity, supply=Supply(volts), things=things)


class ServedPort(Protocol):
    """A port that serves an emulated bus, plugged in or not."""

    @property
    def port(self) -> str: ...

    def plug(self) -> None: ...

    def unplug(self) -> None: ...

    def close(self) -> None: ...


class Emulator:
    """An emulated arm on a port, until closed; a pseudo-terminal unless ``serve`` makes another.

    ``now`` is the clock the physics follows [s], ``gravity`` and ``things`` as in ``World``. The
    methods of ``world`` disturb the servos, ``bus.faults`` the wire; both may be used at any time.
    ``on_open`` is called with every emulator of this process as it is made.
    """

    on_open: ClassVar[list[Callable[[Emulator], None]]] = []

    def __init__(
        self,
        options: EmulatorOptions | None = None,
        *,
        now: Callable[[], float] = time.monotonic,
        gravity: Gravity = no_gravity,
        things: Things | None = None,
        serve: Callable[[Bus], ServedPort] | None = None,
    ) -> None:
        self._options = options or EmulatorOptions()
        self.now, self._gravity = now, gravity
        self.world = build_world(self._options, t=now(), gravity=gravity, things=things)
        self.world.hand = Hand(parse_script(self._options.hand), now())
        self.bus = Bus(self.world, replace(self._options.wire))
        self._own_ids: dict[str, int] = {}  # of twins, by joint
        for attend in self.on_open:
            attend(self)
        self._port: ServedPort = (
            PtyPort(self.bus, now, pacing=self._options.pacing, link=self._options.link)
            if serve is None
            else serve(self.bus)
        )

    @property
    def port(self) -> str:
        """The name a client opens; changes when plugged in again, unless it is a link."""
        return self._port.port

    def unplug(self) -> None:
        """Pull the USB plug; the servos keep their power and go on."""
        self._port.unplug()

    def plug(self) -> None:
        self._port.plug()

    def advance(self) -> None:
        """Let the physics catch up with the clock, as any traffic would.

        For tests that advance the clock by seconds at once: catching up takes some 20 ms for each
        second that six joints moved, longer than many clients wait for an answer.
        """
        self.world.advance(self.now())

    def begin(self, fault: FaultEvent) -> None:
        """Begin a fault now; its ``at`` is ignored."""
        self._change(fault, begins=True)

    def end(self, fault: FaultEvent) -> None:
        self._change(fault, begins=False)

    def _change(self, fault: FaultEvent, *, begins: bool) -> None:
        if fault.kind == "unplug":
            (self.unplug if begins else self.plug)()
            return
        world, place, value = self.world, fault.servo or "", fault.value or 0.0
        with world.lock:
            world.advance(self.now())
            match fault.kind:
                case "dead":
                    (world.disconnect if begins else world.connect)(place)
                case "reboot":
                    if begins:  # it is over by itself
                        world.reboot(place)
                case "hot":
                    world.warm(place, value) if begins else world.cool(place)
                case "brownout":
                    volts = self._options.volts
                    rated = self._options.kind.volts if volts is None else volts
                    world.power(value if begins else rated)
                case "twin":
                    servo = world.servo(place)
                    own = self._own_ids.setdefault(servo.joint.name, servo.memory.raw(reg.ID))
                    servo.memory.set(reg.ID, int(value) if begins else own)
                    if not begins:
                        del self._own_ids[servo.joint.name]  # another one may be written
                case "take":
                    if begins and world.things is not None:
                        world.things.take_away(place)
                case "object":
                    world.put_object(value) if begins else world.take_object()
                case "only" | "chain":
                    plugged = (world.servo(place),) if fault.kind == "only" else world.servos
                    self._plug_in(*(plugged if begins else ()))
                case "pose" | "sweep":
                    world.hand = self._hand_for(fault.kind, value) if begins else Hand()
                case name:
                    setattr(self.bus.faults, name, value if begins else 0.0)

    def _plug_in(self, *servos: Servo) -> None:
        for place, servo in enumerate(self.world.servos, start=1):
            if servo in servos and not servo.connected:
                self.world.connect(place)
            elif servo not in servos:
                self.world.disconnect(place)

    def _hand_for(self, kind: str, speed_deg: float) -> Hand:
        speed = math.radians(speed_deg) if speed_deg > 0.0 else SPEED
        script = (
            holding_script(self._gravity, by=1.0)
            if kind == "pose"
            else sweeping_script(self._gravity, speed=speed)[0]
        )
        return Hand(parse_script(script), self.world.t)

    def close(self) -> None:
        self._port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
