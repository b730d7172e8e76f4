"""The emulated arm: servos, bus, port and faults put together.

Tests run an ``Emulator`` in their own process; the command line runs one in its own (``run.py``). A
test that needs a lost reply or a hot servo calls ``begin`` with a fault; there is nothing to patch.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import ClassVar, Protocol, Self

from so101_motion.common.errors import ConfigError
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.bus import Bus
from so101_motion.drivers.emulator.calibration_scripts import SPEED, holding_script, sweeping_script
from so101_motion.drivers.emulator.electric import Supply
from so101_motion.drivers.emulator.faults import FaultEvent, WireFaults
from so101_motion.drivers.emulator.hand import Hand, parse_script
from so101_motion.drivers.emulator.joint_figures import SO101, Joint
from so101_motion.drivers.emulator.pty_port import Pacing, PtyPort
from so101_motion.drivers.emulator.servo import Servo
from so101_motion.drivers.emulator.spread import differing_servos
from so101_motion.drivers.emulator.world import Gravity, World, no_gravity
from so101_motion.drivers.servo_types import STS3215_12V, ServoFigures, ServoType

ALL_IDS: Mapping[int, int] = {place: place for place in range(1, 7)}
"""A finished arm: ids 1 to 6 from the base to the gripper."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EmulatorOptions:
    """Settings of an emulated arm.

    Attributes:
        link: A symbolic link that always leads to the port; None for none.
        ids: Servo id by place on the cable (1 base .. 6 gripper); places left out are unplugged.
        joints: The joints with their servos' mounting.
        kind: The type of the servos.
        spread: How much the servos differ from each other, see ``spread.py``; 0 for not at all.
        seed: Seed of these differences.
        figures: How servos differ from their type, by joint, instead of at random.
        volts: Supply voltage [V]; None for the servo's rated voltage.
        q_start: Joint angles at the start, shape (6,), [rad].
        loose: Whether no servo is on the cable at the start, whatever their ids.
        calibrated: Whether limits are stored in the servos, or they are as new (0 to 4095).
        goal_enables_torque: Whether writing a goal switches torque on.
        dither: How far readings of a resting joint scatter [tick]; 3 on the measured arm.
        pacing: Wire time and adapter latency.
        wire: Disturbed replies.
        faults: Timed faults.
        hand: A hand script, see ``hand.py``.
    """

    link: Path | None = None
    ids: Mapping[int, int] = field(default_factory=lambda: dict(ALL_IDS))
    joints: tuple[Joint, ...] = SO101
    kind: ServoType = STS3215_12V
    spread: float = 0.0
    seed: int = 0
    figures: Mapping[str, ServoFigures] = field(default_factory=dict)
    volts: float | None = None
    q_start: tuple[float, ...] = (0.0,) * 6
    loose: bool = False
    calibrated: bool = True
    goal_enables_torque: bool = True
    dither: int = 0
    pacing: Pacing = field(default_factory=Pacing)
    wire: WireFaults = field(default_factory=WireFaults)
    faults: tuple[FaultEvent, ...] = ()
    hand: str = ""


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
    options: EmulatorOptions, *, t: float = 0.0, gravity: Gravity = no_gravity
) -> World:
    """Build servos and supply from the options, without a port.

    Args:
        options: What to emulate.
        t: Time now, on the clock ``advance`` will be called with [s].
        gravity: Holding torque [N m] as a function of the six joint angles [rad].
    """
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
    return World(servos, t=t, gravity=gravity, supply=Supply(volts))


class ServedPort(Protocol):
    """A port that serves an emulated bus, plugged in or not."""

    @property
    def port(self) -> str:
        """The name that a client opens."""

    def plug(self) -> None:
        """Create the port if it does not exist."""

    def unplug(self) -> None:
        """Remove the port, even if a client has it open."""

    def close(self) -> None:
        """Remove the port for good."""


class Emulator:
    """An emulated arm on a port, until closed.

    Args:
        options: What to emulate.
        now: The clock the physics follows [s].
        gravity: Holding torque [N m] as a function of the six joint angles [rad].
        serve: Makes the port; a pseudo-terminal by default.

    Attributes:
        world: The servos; its methods disturb them.
        bus: The wire; ``bus.faults`` may be changed at any time.
        now: The clock the physics follows [s].
        on_open: Called with every emulator of this process as it is made.
    """

    on_open: ClassVar[list[Callable[[Emulator], None]]] = []

    def __init__(
        self,
        options: EmulatorOptions | None = None,
        *,
        now: Callable[[], float] = time.monotonic,
        gravity: Gravity = no_gravity,
        serve: Callable[[Bus], ServedPort] | None = None,
    ) -> None:
        self._options = options or EmulatorOptions()
        self.now, self._gravity = now, gravity
        self.world = build_world(self._options, t=now(), gravity=gravity)
        self.world.hand = Hand(parse_script(self._options.hand), now())
        self.bus = Bus(self.world, replace(self._options.wire))
        self._ids = [servo.memory.raw(reg.ID) for servo in self.world.servos]
        for attend in self.on_open:
            attend(self)
        self._port = serve(self.bus) if serve is not None else self._on_terminal(self.bus)

    def _on_terminal(self, bus: Bus) -> ServedPort:
        return PtyPort(bus, self.now, pacing=self._options.pacing, link=self._options.link)

    @property
    def port(self) -> str:
        """The name a client opens; changes when plugged in again, unless it is a link."""
        return self._port.port

    def unplug(self) -> None:
        """Pull the USB plug; the servos keep their power and go on."""
        self._port.unplug()

    def plug(self) -> None:
        """Put the USB plug back."""
        self._port.plug()

    def advance(self) -> None:
        """Let the physics catch up with the clock, as any traffic would.

        For tests that advance the clock by seconds at once: catching up takes some 20 ms for each
        second that six joints moved, longer than many clients wait for an answer.
        """
        self.world.advance(self.now())

    def begin(self, fault: FaultEvent) -> None:
        """Begin a fault now; its ``at`` is ignored."""
        if fault.kind == "unplug":
            self.unplug()
            return
        value = fault.value if fault.value is not None else 0.0
        place = fault.servo or ""
        with self.world.lock:
            self.world.advance(self.now())
            match fault.kind:
                case "dead":
                    self.world.disconnect(place)
                case "reboot":
                    self.world.reboot(place)
                case "hot":
                    self.world.warm(place, value)
                case "brownout":
                    self.world.power(value)
                case "twin":
                    self.world.servo(place).memory.set(reg.ID, int(value))
                case "object":
                    self.world.put_object(value)
                case "only":
                    self._plug_in(self.world.servo(place))
                case "chain":
                    self._plug_in(*self.world.servos)
                case "pose":
                    self._take_in_hand(holding_script(self._gravity, by=1.0))
                case "sweep":
                    speed = math.radians(value) if value > 0.0 else SPEED
                    self._take_in_hand(sweeping_script(self._gravity, speed=speed)[0])
                case name:
                    setattr(self.bus.faults, name, value)

    def end(self, fault: FaultEvent) -> None:
        """End a fault."""
        if fault.kind == "unplug":
            self.plug()
            return
        place = fault.servo or ""
        with self.world.lock:
            self.world.advance(self.now())
            match fault.kind:
                case "dead":
                    self.world.connect(place)
                case "reboot":
                    pass  # over by itself
                case "hot":
                    self.world.cool(place)
                case "brownout":
                    volts = self._options.volts
                    self.world.power(self._options.kind.volts if volts is None else volts)
                case "twin":
                    servo = self.world.servo(place)
                    servo.memory.set(reg.ID, self._ids[self.world.servos.index(servo)])
                case "object":
                    self.world.take_object()
                case "only" | "chain":
                    self._plug_in()
                case "pose" | "sweep":
                    self.world.hand = Hand()
                case name:
                    setattr(self.bus.faults, name, 0.0)

    def _plug_in(self, *servos: Servo) -> None:
        """Connect these servos to the cable and disconnect all others."""
        for place, servo in enumerate(self.world.servos, start=1):
            if servo in servos and not servo.connected:
                self.world.connect(place)
            elif servo not in servos:
                self.world.disconnect(place)

    def _take_in_hand(self, script: str) -> None:
        self.world.hand = Hand(parse_script(script), self.world.t)

    def close(self) -> None:
        """Take the port away and end the thread."""
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
