"""The register table of the STS3215 servo, as the driver uses it.

A ``Register`` is one row. Words are little-endian. Signed registers are sign-magnitude: one bit is
the sign, the bits below it are the size; which bit (10, 11, 15) is a property of the row.

*Measured* registers are read-only. *RAM* starts from its default whenever the servo gets power.
*EEPROM* takes effect at once but is forgotten at power-off unless it was written while ``LOCK`` was
0; ``Bus.store`` does that.

Sources, named in the rows:
    FT  Feetech's STS memory table
    WS  Waveshare's ST3215 memory table
    FW  github.com/0o8o0-blip/sts3215-firmware, a re-implementation of firmware 3.10
    LR  huggingface/lerobot, tables.py
Where they disagree the row says what is used and why.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, IntFlag

END = 87
"""Reads are cut before this address (FW)."""

TICKS_PER_TURN = 4096
"""Encoder counts of one turn of the output shaft (datasheet)."""

BROADCAST = 0xFE
"""The id every servo listens to."""

BAUDS = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)
"""Baud rate by the code in ``BAUD_RATE`` (FT, WS, FW; the codes 5 to 7 of LR are wrong)."""

_TICK = 2.0 * math.pi / TICKS_PER_TURN


class Memory(Enum):
    """How long a register keeps its value."""

    MEASURED = "read-only"
    RAM = "until power-off"
    EEPROM = "for good, if written unlocked"


class Fault(IntFlag):
    """Bits of the status byte that every reply carries, and of register 65.

    They are about the servo: a reading with one is valid, a write that it acknowledges was done.
    """

    NONE = 0
    VOLTAGE = 0x01
    ENCODER = 0x02
    OVERHEATED = 0x04
    OVERCURRENT = 0x08
    OVERLOAD = 0x20

    @property
    def names(self) -> tuple[str, ...]:
        """The set bits as words; reserved bits have none."""
        return tuple(fault.name.lower() for fault in type(self) if fault & self and fault.name)


LET_GO = Fault.OVERHEATED | Fault.OVERCURRENT
"""A servo that reports one of these has switched its motor off (FT, FW). In overload it drives on
with a fifth; at a wrong voltage it drives on as well, unless register 19 says otherwise."""


@dataclass(frozen=True, slots=True)
class Register:
    """One row of the table."""

    name: str  # as in LR, in lower case
    address: int  # of the first byte
    size: int  # bytes, 1 or 2
    memory: Memory  # how long it keeps a value
    lower: int  # smallest value that may be written
    upper: int  # largest
    unit: str  # what one count is, in words
    scale: float  # the same in SI (a share of full drive, degC); 1 for codes and bare numbers
    source: str  # who says so
    sign_bit: int | None = None  # which bit is the sign; None for unsigned

    def decode(self, data: bytes) -> int:
        """The number in ``data``, which holds ``size`` bytes.

        Bits above the sign continue the magnitude: firmware 3.10 stores homing offsets beyond 2047
        like this, and nothing else sets them (FW).
        """
        if len(data) != self.size:
            raise ValueError(f"{self.name} has {self.size} bytes, not {len(data)}")
        raw = int.from_bytes(data, "little")
        if self.sign_bit is None:
            return raw
        low = (1 << self.sign_bit) - 1
        size = (raw & low) | (raw >> (self.sign_bit + 1) << self.sign_bit)
        return -size if raw >> self.sign_bit & 1 else size

    def encode(self, value: int) -> bytes:
        """The bytes that mean ``value``; ``ValueError`` if it may not be written."""
        if not self.lower <= value <= self.upper:
            raise ValueError(f"{self.name} takes {self.lower} to {self.upper}, not {value}")
        raw = abs(value)
        if value < 0:
            assert self.sign_bit is not None  # the table's ranges see to that
            raw |= 1 << self.sign_bit
        return raw.to_bytes(self.size, "little")

    def cut(self, block: bytes, start: int) -> int:
        """The number at this register in ``block``, which was read from address ``start``."""
        begin = self.address - start
        return self.decode(block[begin : begin + self.size])


_M, _R, _E = Memory.MEASURED, Memory.RAM, Memory.EEPROM

# fmt: off
FIRMWARE_MAJOR = Register("firmware_major", 0, 1, _M, 0, 255, "", 1, "FT")
FIRMWARE_MINOR = Register("firmware_minor", 1, 1, _M, 0, 255, "", 1, "FT; 6, 9, 10 seen")
MODEL_NUMBER = Register("model_number", 3, 2, _M, 0, 65535, "", 1, "LR: 777 is the STS3215")
ID = Register("id", 5, 1, _E, 0, 253, "", 1, "FT")
BAUD_RATE = Register("baud_rate", 6, 1, _E, 0, 7, "code", 1, "FT, WS, FW; see BAUDS")
RETURN_DELAY = Register("return_delay", 7, 1, _E, 0, 254, "2 us", 2e-6, "FT; unused (FW)")
STATUS_LEVEL = Register("status_level", 8, 1, _E, 0, 1, "1: acknowledge writes", 1, "FT")
MIN_POSITION = Register("min_position", 9, 2, _E, 0, 4094, "tick", _TICK, "FT")
MAX_POSITION = Register("max_position", 11, 2, _E, 1, 4095, "tick", _TICK, "FT")
MAX_TEMPERATURE = Register("max_temperature", 13, 1, _E, 0, 100, "degC", 1, "FT")
MAX_VOLTAGE = Register("max_voltage", 14, 1, _E, 0, 254, "0.1 V", 0.1, "FT")
MIN_VOLTAGE = Register("min_voltage", 15, 1, _E, 0, 254, "0.1 V", 0.1, "FT")
MAX_TORQUE = Register("max_torque", 16, 2, _E, 0, 1000, "0.1 % drive", 1e-3,
                      "FT, WS, FW: copied to 48 at power-up only")
PHASE = Register("phase", 18, 1, _E, 0, 254, "bits", 1, "FT, FW; see MULTI_TURN")
UNLOADING = Register("unloading_condition", 19, 1, _E, 0, 254, "status bits", 1, "FT")
LED_ALARM = Register("led_alarm", 20, 1, _E, 0, 254, "status bits", 1, "FT")
P_GAIN = Register("p_gain", 21, 1, _E, 0, 254, "1/4 permille drive per tick", 1, "FT, FW")
D_GAIN = Register("d_gain", 22, 1, _E, 0, 254, "", 1, "FT; the order is P, D, I")
I_GAIN = Register("i_gain", 23, 1, _E, 0, 254, "", 1, "FT")
STARTUP_FORCE = Register("startup_force", 24, 1, _E, 0, 254, "0.1 % drive", 1e-3,
                         "FT one byte; LR and WS two")
I_LIMIT = Register("i_limit", 25, 1, _E, 0, 254, "0.4 % drive", 4e-3, "FT")
CW_DEAD_ZONE = Register("cw_dead_zone", 26, 1, _E, 0, 16, "tick", _TICK, "FT 16; WS 32")
CCW_DEAD_ZONE = Register("ccw_dead_zone", 27, 1, _E, 0, 16, "tick", _TICK, "FT 16; WS 32")
PROTECTION_CURRENT = Register("protection_current", 28, 2, _E, 0, 2047, "6.5 mA", 6.5e-3,
                              "FT 2047; WS 511")
RESOLUTION = Register("angular_resolution", 30, 1, _E, 1, 128, "", 1, "FT")
HOMING_OFFSET = Register("homing_offset", 31, 2, _E, -2047, 2047, "tick", _TICK, "FT, LR", 11)
OPERATING_MODE = Register("operating_mode", 33, 1, _E, 0, 3, "0: position", 1, "FT")
PROTECTIVE_TORQUE = Register("protective_torque", 34, 1, _E, 0, 100, "% drive", 1e-2,
                             "FT: what is left after an overload")
PROTECTION_TIME = Register("protection_time", 35, 1, _E, 0, 254, "10 ms", 1e-2, "FT")
OVERLOAD_TORQUE = Register("overload_torque", 36, 1, _E, 0, 100, "% drive", 1e-2,
                           "FT: the threshold; LR takes it for 34")
OVERCURRENT_TIME = Register("overcurrent_time", 38, 1, _E, 0, 254, "10 ms", 1e-2, "FT, FW")
TORQUE_ENABLE = Register("torque_enable", 40, 1, _R, 0, 2, "0 off, 1 on, 2 damping", 1,
                         "FT; its 128 would rewrite 31, so it is not offered")
ACCELERATION = Register("acceleration", 41, 1, _R, 1, 254, "100 tick/s^2", 100 * _TICK,
                        "FT; 0 is the servo's word for maximum, so it is not offered")
GOAL_POSITION = Register("goal_position", 42, 2, _R, -32766, 32766, "tick", _TICK, "FT", 15)
GOAL_TIME = Register("goal_time", 44, 2, _R, -1000, 1000, "inert", 1, "FW: drive in PWM mode", 10)
GOAL_VELOCITY = Register("goal_velocity", 46, 2, _R, 1, 32766, "tick/s", _TICK,
                         "FT; 0 is the servo's word for maximum, so it is not offered", 15)
TORQUE_LIMIT = Register("torque_limit", 48, 2, _R, 0, 1000, "0.1 % drive", 1e-3, "FT, FW")
LOCK = Register("lock", 55, 1, _R, 0, 1, "0: EEPROM writes are kept", 1, "FT, FW; WS differs")
PRESENT_POSITION = Register("present_position", 56, 2, _M, -32766, 32766, "tick", _TICK, "FT", 15)
PRESENT_VELOCITY = Register("present_velocity", 58, 2, _M, -32766, 32766, "tick/s", _TICK,
                            "FT; steps of 50 (FW)", 15)
PRESENT_LOAD = Register("present_load", 60, 2, _M, -1000, 1000, "0.1 % drive", -1e-3,
                        "FT, LR: drive, not torque; recorded: > 0 towards lower ticks", 10)
PRESENT_VOLTAGE = Register("present_voltage", 62, 1, _M, 0, 255, "0.1 V", 0.1, "FT")
PRESENT_TEMPERATURE = Register("present_temperature", 63, 1, _M, 0, 255, "degC", 1, "FT")
STATUS = Register("status", 65, 1, _M, 0, 255, "status bits", 1, "FT")
MOVING = Register("moving", 66, 1, _M, 0, 1, "", 1, "FT: the profile runs")
PRESENT_CURRENT = Register("present_current", 69, 2, _M, -32766, 32766, "6.5 mA", 6.5e-3,
                           "FT; the sign is FW's", 15)
D_WINDOW = Register("d_window", 81, 1, _E, 1, 254, "ms", 1e-3, "FT, FW")
MIN_SPEED = Register("min_speed", 83, 1, _E, 0, 254, "50 tick/s", 50 * _TICK, "FW; FT: SMS")
MAX_SPEED = Register("max_speed", 84, 1, _E, 0, 254, "50 tick/s", 50 * _TICK, "FT, FW")
MAX_ACCELERATION = Register("max_acceleration", 85, 1, _E, 0, 254, "100 tick/s^2", 100 * _TICK,
                            "FW: 41 is cut here; LR writes 254")
# fmt: on

REGISTERS: dict[str, Register] = {
    row.name: row for row in list(globals().values()) if isinstance(row, Register)
}
"""Every row by its name."""

MULTI_TURN = 0x10
"""Bit of ``PHASE``: positions leave 0..4095 when the shaft turns on. LR clears it as well."""

SPEED_BITS = 0x0C
"""Bits of ``PHASE``: speeds are in tick/s, not in 50 tick/s; speed 0 is the highest, not a
standstill. Both are set in a new servo (FT, FW)."""

REVERSED = 0x81
"""Bits of ``PHASE``: the motor or the encoder turns the other way. Never set in a new servo (FT).
A servo with one of them alone runs away, so they are only changed together, and limp."""

STS3215_MODEL = 777
"""``MODEL_NUMBER`` of the arm's servos (LR)."""
