"""A lent bus for calibrations and motor setup, without a port.

The emulated servos answer inside the call that asks, at any rate.
"""

import time
from contextlib import nullcontext

import pytest

from harness.direct_port import DirectPort
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import MotorSetupError
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.emulator import registers as emulated
from so101_motion.drivers.emulator.bus import Bus as EmulatedBus
from so101_motion.drivers.emulator.emulator import EmulatorOptions, build_world
from so101_motion.drivers.emulator.faults import WireFaults
from so101_motion.setup.motor_operation import MotorOperation

APART = (0.1, -0.4, 0.5, -0.2, 0.7, 0.3)
"""Joint angles [rad] that differ, as those of loose servos do; twins are noticed by that."""


class WirePort(DirectPort):
    """Keeps every packet with the rate it was sent at; adds up what is waited in vain [s]."""

    name = "/dev/wired"

    def __init__(self, bus, now, baud):
        super().__init__(bus, now, self._wait_in_vain)
        self.sent, self.baud, self.silence = [], baud, 0.0

    def _wait_in_vain(self, until):
        self.silence += max(0.0, until - time.monotonic())

    def passed(self, request, replies):
        self.sent.append((self.baud, bytes(request)))
        return super().passed(request, replies)


class LentBus:
    """Fits ``BusAccess``.

    Args:
        loose: The servos that hang on the adapter, as id by place; the others are unplugged.
        baud: The port's own rate.

    Attributes:
        before: Called before each job; for what happens in between.
    """

    kind_of_port = WirePort

    def __init__(self, loose=None, *, baud=1_000_000, reply_timeout=0.0, **options):
        self.clock = ManualClock()
        options.setdefault("q_start", APART)
        if loose is not None:
            options["ids"] = loose
        self.world = build_world(EmulatorOptions(**options), t=0.0)
        self.faults = WireFaults()
        self.wire = self.kind_of_port(EmulatedBus(self.world, self.faults), self.clock.now, baud)
        self.rates = []
        self.before = lambda: None
        self.bus = Bus(self.wire, reply_timeout=reply_timeout)

    @property
    def port(self):
        return self.wire.name

    @property
    def waited(self):
        """How long was waited, in vain or on purpose [s]."""
        return self.wire.silence + self.clock.now()

    def lent(self):
        return nullcontext(self)

    def call(self, job):
        self.before()
        return job(self.bus)

    def watch(self, job):
        raise NotImplementedError

    def at_baud(self, baud):
        self.rates.append(baud)
        self.wire.baud = baud

    # What a test does to the servos

    def plug(self, *places):
        """Let just these hang on the adapter, powered up."""
        for place in range(1, 7):
            (self.world.connect if place in places else self.world.disconnect)(str(place))
        self.settle()

    def settle(self):
        """Let the servos that were switched on start up."""
        self.clock.advance(2.0)
        self.world.advance(self.clock.now())
        self.clock.advance(2.0)
        self.world.advance(self.clock.now())

    def set(self, place, **values):
        """Let the servo at ``place`` hold values for good, by the driver's register names."""
        memory = self.world.servo(str(place)).memory
        for name, value in values.items():
            row = reg.REGISTERS[name]
            held = emulated.Register(row.address, row.size, emulated.Keep.EEPROM, 0, 0, 0, "", "")
            memory.keep(held, int.from_bytes(row.encode(value), "little"))

    def holds(self, place, register, *, after_power_off=False):
        """What a register of the servo at ``place`` holds."""
        servo = self.world.servo(str(place))
        data = servo.memory.flash if after_power_off else servo.memory.bytes
        return register.cut(bytes(data), 0)

    def whole_arm(self):
        self.plug(1, 2, 3, 4, 5, 6)


def loose(servo_id=1, baud=1_000_000, place=6, **options):
    """One servo alone on the adapter, and its setup."""
    bus = LentBus({place: servo_id}, calibrated=False, **options)
    bus.set(place, baud_rate=reg.BAUDS.index(baud))
    return bus, MotorOperation(bus.lent)


def refused(call, problem, *words):
    """``call`` is refused for that problem, with these words; the error."""
    with pytest.raises(MotorSetupError) as caught:
        call()
    assert caught.value.problem == problem
    for word in words:
        assert word in str(caught.value)
    assert caught.value.next_step
    return caught.value
