"""The memory map of the emulated servo, one row per register.

Addresses are decimal and words little-endian, as in the manufacturer's table. ``Keep`` says who
may change a register and how long it lasts: EEPROM survives a power cycle if it was written while
Lock (55) was 0, RAM starts from its default at every boot, read-only is what the servo measures.
``lower`` and ``upper`` bound the value the servo *uses*; the bytes written are read back as they
are. ``sign_bit`` marks sign-magnitude registers: the bit is the sign, the bits below the size.

Sources, named in the rows:
    FT  Feetech STS memory table and SCS protocol (English), defaults of a 12 V STS3215
    WS  Waveshare ST3215 memory table
    FW  github.com/0o8o0-blip/sts3215-firmware, a re-implementation of firmware 3.10 and the dump
        of a factory servo
    LR  huggingface/lerobot, tables.py
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

SIZE = 87
"""Addresses 0..86 can be read; a read that reaches further is cut there (FW)."""

TICKS_PER_TURN = 4096
"""Encoder counts of one turn of the output shaft (datasheet)."""

BAUDS = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)
"""Baud rate by the code in register 6 (FT, WS, FW)."""


class Keep(Enum):
    """Who may write a register, and what happens to it when the power goes."""

    READ_ONLY = "measured"
    EEPROM = "kept"
    RAM = "reset at boot"


@dataclass(frozen=True, slots=True)
class Register:
    """One row of the memory map."""

    address: int  # first byte
    size: int  # bytes, 1 or 2
    keep: Keep  # read-only, EEPROM or RAM
    default: int  # value of a new servo, as stored (sign bit included)
    lower: int  # smallest value the servo uses
    upper: int  # largest value the servo uses
    unit: str  # what one count means
    source: str  # where the row comes from; disagreements
    sign_bit: int | None = None  # bit that holds the sign, or None for an unsigned register

    def decode(self, raw: int) -> int:
        if self.sign_bit is None or not raw >> self.sign_bit & 1:
            return raw
        return -(raw & (1 << self.sign_bit) - 1)

    def encode(self, value: int) -> int:
        """The stored bits for a number; magnitudes too large for the register are clamped."""
        top = 8 * self.size if self.sign_bit is None else self.sign_bit
        magnitude = min(abs(value), (1 << top) - 1)
        if value >= 0 or self.sign_bit is None:
            return magnitude
        return magnitude | 1 << self.sign_bit


_RO, _EE, _RAM = Keep.READ_ONLY, Keep.EEPROM, Keep.RAM

FIRMWARE_MAJOR = Register(0, 1, _RO, 3, 0, 255, "", "FT")
FIRMWARE_MINOR = Register(1, 1, _RO, 10, 0, 255, "", "FT; 6, 9 and 10 seen in the field")
ENDIAN = Register(2, 1, _RO, 0, 0, 1, "0 = little", "FT")
MODEL = Register(3, 2, _RO, 777, 0, 65535, "", "LR 777; FT calls the bytes 9, 3 servo version")
ID = Register(5, 1, _EE, 1, 0, 253, "", "FT")
BAUD = Register(6, 1, _EE, 0, 0, 7, "code", "FT, WS, FW; LR's names for 5, 6, 7 are wrong")
RETURN_DELAY = Register(7, 1, _EE, 0, 0, 254, "2 us", "FT; never used by the firmware (FW)")
STATUS_LEVEL = Register(8, 1, _EE, 1, 0, 1, "0: answer ping and read only", "FT")
MIN_POSITION = Register(9, 2, _EE, 0, 0, 4094, "tick", "FT; equal limits switch clamping off")
MAX_POSITION = Register(11, 2, _EE, 4095, 1, 4095, "tick", "FT")
MAX_TEMPERATURE = Register(13, 1, _EE, 70, 0, 100, "degC", "FT, FW")
MAX_VOLTAGE = Register(14, 1, _EE, 140, 0, 254, "0.1 V", "FW 140 (12 V type); WS 80 (7.4 V type)")
MIN_VOLTAGE = Register(15, 1, _EE, 40, 0, 254, "0.1 V", "FT")
MAX_TORQUE = Register(16, 2, _EE, 1000, 0, 1000, "0.1 % PWM", "FT; copied to 48 at power-up only")
PHASE = Register(18, 1, _EE, 12, 0, 254, "bits", "FT, FW; see PHASE_*")
UNLOADING = Register(19, 1, _EE, 44, 0, 254, "status bits", "FT: which faults act on the motor")
LED_ALARM = Register(20, 1, _EE, 47, 0, 254, "status bits", "FT")
P_GAIN = Register(21, 1, _EE, 32, 0, 254, "PWM/4 per tick", "FT, FW")
D_GAIN = Register(22, 1, _EE, 32, 0, 254, "PWM/8 per tick in 20 ms", "FT, FW")
I_GAIN = Register(23, 1, _EE, 0, 0, 254, "PWM/500 per tick ms", "FT, FW")
STARTUP_FORCE = Register(24, 1, _EE, 16, 0, 254, "0.1 % PWM", "FT one byte; LR two")
I_LIMIT = Register(25, 1, _EE, 0, 0, 254, "0.4 % PWM, 0 = none", "FT; LR: high byte of 24")
CW_DEAD_ZONE = Register(26, 1, _EE, 1, 0, 32, "tick", "FT 16, WS 32")
CCW_DEAD_ZONE = Register(27, 1, _EE, 1, 0, 32, "tick", "FT 16, WS 32")
PROTECTION_CURRENT = Register(28, 2, _EE, 500, 0, 2047, "6.5 mA", "WS 500; FT 511, FW dump 310")
RESOLUTION = Register(30, 1, _EE, 1, 1, 128, "multiplier", "FT")
OFFSET = Register(31, 2, _EE, 0, 0, 8191, "tick", "FT; see decode_offset")
MODE = Register(33, 1, _EE, 0, 0, 3, "0 position 1 speed 2 PWM 3 step", "FT")
PROTECTIVE_TORQUE = Register(34, 1, _EE, 20, 0, 100, "% PWM", "FT: held after an overload")
PROTECTION_TIME = Register(35, 1, _EE, 200, 0, 254, "10 ms", "FT")
OVERLOAD_TORQUE = Register(36, 1, _EE, 80, 0, 254, "% PWM", "FT: threshold")
SPEED_P = Register(37, 1, _EE, 10, 0, 254, "", "WS, FW")
OVERCURRENT_TIME = Register(38, 1, _EE, 200, 0, 254, "10 ms", "FT, FW")
SPEED_I = Register(39, 1, _EE, 200, 0, 254, "", "FW 200; WS 10")
TORQUE_ENABLE = Register(40, 1, _RAM, 0, 0, 255, "0 off 1 on 2 damping 128 centre here", "FT")
ACCELERATION = Register(41, 1, _RAM, 0, 0, 254, "100 tick/s^2", "FT; 0 = maximum")
GOAL_POSITION = Register(42, 2, _RAM, 0, -32766, 32766, "tick", "FT", 15)
GOAL_TIME = Register(44, 2, _RAM, 0, -1000, 1000, "0.1 % PWM in mode 2", "FW; ignored else", 10)
GOAL_VELOCITY = Register(46, 2, _RAM, 0, -32766, 32766, "tick/s", "FT, FW; 0 = maximum", 15)
TORQUE_LIMIT = Register(48, 2, _RAM, 1000, 0, 1000, "0.1 % PWM", "FT, FW: acts at once")
LOCK = Register(55, 1, _RAM, 1, 0, 255, "0 = EEPROM writes are saved", "FT, FW; WS says 0")
PRESENT_POSITION = Register(56, 2, _RO, 0, -32766, 32766, "tick", "FT", 15)
PRESENT_VELOCITY = Register(58, 2, _RO, 0, -32766, 32766, "tick/s, steps of 50", "FT, FW", 15)
PRESENT_LOAD = Register(60, 2, _RO, 0, -1000, 1000, "0.1 % PWM", "FT", 10)
PRESENT_VOLTAGE = Register(62, 1, _RO, 0, 0, 255, "0.1 V", "FT")
PRESENT_TEMPERATURE = Register(63, 1, _RO, 0, 0, 255, "degC", "FT")
PENDING = Register(64, 1, _RO, 0, 0, 1, "a reg-write waits", "FT, FW")
STATUS = Register(65, 1, _RO, 0, 0, 255, "status bits", "FT: in every reply")
MOVING = Register(66, 1, _RO, 0, 0, 1, "the profile runs", "FT")
SETPOINT = Register(67, 2, _RO, 0, -32766, 32766, "tick", "FW: the profile; FT: the goal", 15)
PRESENT_CURRENT = Register(69, 2, _RO, 0, -32766, 32766, "6.5 mA", "FT; sign only FW", 15)
PROFILE_SPEED = Register(71, 2, _RO, 0, -32766, 32766, "tick/s", "FW; LR: Goal_Position_2", 15)
MOVING_THRESHOLD = Register(80, 1, _EE, 2, 0, 254, "tick in 20 ms", "FT, FW")
D_WINDOW = Register(81, 1, _EE, 20, 1, 254, "ms", "FT, FW")
SPEED_UNIT = Register(82, 1, _EE, 50, 1, 254, "tick/s", "FT, FW")
MIN_SPEED = Register(83, 1, _EE, 1, 0, 254, "50 tick/s", "FW; FT: SMS only")
MAX_SPEED = Register(84, 1, _EE, 150, 0, 254, "50 tick/s", "FT, FW")
MAX_ACCELERATION = Register(85, 1, _EE, 100, 0, 254, "100 tick/s^2", "FW; LR writes it")
ACCELERATION_FACTOR = Register(86, 1, _EE, 1, 0, 254, "used when 41 is 0", "FT, FW")

REGISTERS: dict[str, Register] = {
    name: row for name, row in globals().items() if isinstance(row, Register)
}
"""Every row by its name in this file."""

POSITION_MODE, SPEED_MODE, PWM_MODE, STEP_MODE = range(4)
"""Values of ``MODE``."""

PHASE_DRIVE_REVERSED = 0x01
PHASE_SPEED_IN_TICKS = 0x04
"""Set: register 46 counts 1 tick/s; clear: ``SPEED_UNIT`` tick/s."""
PHASE_ZERO_IS_MAX = 0x08
"""Set: speed 0 means maximum; clear: speed 0 means stand still."""
PHASE_MULTI_TURN = 0x10
"""Set: Present_Position leaves 0..4095 when the shaft turns on."""
PHASE_ENCODER_REVERSED = 0x80

VOLTAGE_FAULT, ENCODER_FAULT, OVERHEATED, OVERCURRENT, OVERLOAD = 0x01, 0x02, 0x04, 0x08, 0x20
"""Bits of the status byte and of the two masks (FT)."""


def decode_offset(raw: int) -> int:
    """Homing offset [tick] from register 31: bit 11 is the sign, bit 12 adds 2048 (FW)."""
    magnitude = (raw & 0x7FF) + (2048 if raw & 0x1000 else 0)
    return -magnitude if raw & 0x800 else magnitude


def encode_offset(offset: int) -> int:
    """Register 31 for a homing offset of -4095..4095 [tick]."""
    magnitude = min(abs(offset), 4095)
    high = 0x1000 if magnitude >= 2048 else 0
    return high | magnitude & 0x7FF | (0x800 if offset < 0 and magnitude else 0)
