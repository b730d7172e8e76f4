"""Judge the settings of a servo: which of them keep it from moving its joint well.

A setting is *adapted* when it only tells the servo how to take the driver's numbers, or how hard it
follows them: opening the arm then sets it as new **until power-off** (the memory stays locked). A
setting that protects the servo, or that tells which way it turns, is never changed by opening. The
motor setup (``so101 setup --repair``) sets all of them as new for good.

Limits are chosen such that an emulated arm moves well inside them, and wide, because people tune
gains on purpose; the values "as new" are the manufacturer's (sources in ``registers.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.registers import Register
from so101_motion.drivers.bus.ticks import TOP_ACCELERATION_UNITS
from so101_motion.drivers.servo_types import type_of

PROTECTIONS = 44
"""Faults that act on the motor: temperature, current, overload; as delivered (FT)."""

REPAIR = 'so101 setup --repair (on a machine the calibration sensor\'s "motor_setup_repair")'
"""What sets all settings as new for good."""

_GAINS = {reg.P_GAIN: 32, reg.D_GAIN: 32, reg.I_GAIN: 0}  # as delivered (FT, WS)
_LEAST_TORQUE, _ELSEWHERE = {2: 1.64, 3: 1.12}, 0.5
"""With less torque than this a servo does not lift an arm that is stretched out [N m], by its id;
emulated, both types: shoulder_lift failed with 1.59 and 1.62 and lifted with 1.62 and 1.64, the
elbow failed with 1.01 and 1.05 and lifted with 1.18 and 1.15."""

_ELBOW_HOLDS, _OTHERS_HOLD = 1.05, 15.0
"""A servo whose drive is cut to less than this after an overload lets the arm sink: the elbow's
[N m] (emulated, 7.4 V: it sank with 1.03 and held with 1.07), others' [% drive] (chosen)."""

_SOFTEST = 16  # P gain; LeRobot's, the softest any program uses on purpose
_MOST_I = 50  # I gain; an emulated joint swings with 254. Chosen


@dataclass(frozen=True, slots=True)
class OddSetting:
    """A setting with which a servo does not move its joint well, with the register's value."""

    sentence: str
    as_new: Mapping[Register, int]  # the registers to write, and what they hold in a new servo
    is_adapted: bool = False  # whether opening the arm sets it as new until power-off
    forbids: bool = False  # whether the joint must not be moved as long as it is so

    @property
    def fix(self) -> str:
        does = "does so" if self.is_adapted else "sets it as new"
        opening = "opening the arm sets it right until power-off; " if self.is_adapted else ""
        return f"{opening}{REPAIR} {does} for good"


@dataclass(frozen=True, slots=True)
class _Range:
    """The values of a register with which a servo moves well."""

    register: Register
    lowest: int
    highest: int
    as_new: int
    sentence: str


ADAPTED = (
    _Range(reg.STATUS_LEVEL, 1, 1, 1, "it does not acknowledge commands"),
    _Range(reg.OPERATING_MODE, 0, 0, 0, "it is in mode {0}, not in position mode"),
    _Range(reg.RESOLUTION, 1, 1, 1, "its resolution is {0}, so it takes each goal {0} times"),
    _Range(reg.STARTUP_FORCE, 0, 60, 16, "its startup force is {0}, so it shakes"),
    _Range(reg.CW_DEAD_ZONE, 0, 8, 1, "its dead zone (clockwise) is {0} ticks wide"),
    _Range(reg.CCW_DEAD_ZONE, 0, 8, 1, "its dead zone (counter-clockwise) is {0} ticks wide"),
    _Range(
        reg.D_WINDOW, 1, 100, 20, "its D gain compares with {0} ms before, so damping comes late"
    ),
    _Range(reg.MIN_SPEED, 0, 2, 1, "its lowest speed is {0} x 50 tick/s, so it cannot crawl"),
    _Range(reg.MAX_SPEED, 60, 254, 150, "its highest speed is {0} x 50 tick/s: it falls behind"),
)
PROTECTING = (
    _Range(reg.PROTECTION_CURRENT, 100, 2047, 500, "it switches off at a current of {0} x 6.5 mA"),
    _Range(reg.OVERCURRENT_TIME, 10, 254, 200, "it switches off after {0} x 10 ms of high current"),
    _Range(reg.OVERLOAD_TORQUE, 20, 100, 80, "it reports an overload at {0} % drive"),
    _Range(reg.PROTECTION_TIME, 20, 254, 200, "it reports an overload after {0} x 10 ms of drive"),
)
_TRIPS = range(1, 13)
"""Currents at which a servo lets go as soon as it moves [6.5 mA]; emulated, 12 did so at 7.4 V."""
_SPANS = ((0, reg.PRESENT_CURRENT.address + 2), (reg.D_WINDOW.address, reg.END))
_JUDGED = (
    *(row.register for row in (*ADAPTED, *PROTECTING)),
    *(reg.PHASE, reg.MAX_TEMPERATURE, reg.MAX_TORQUE, reg.UNLOADING, *_GAINS),
    reg.MAX_ACCELERATION,
)


def read_registers(bus: Bus, servo_id: int) -> dict[str, int]:
    held: dict[str, int] = {}
    for start, end in _SPANS:  # not all at once: a stale reply is told by its length
        block = bus.read_block(servo_id, start, end - start, what="a read of its settings")
        held |= {
            row.name: row.cut(block, start)
            for row in reg.REGISTERS.values()
            if start <= row.address < end
        }
    return held


def odd_settings(held: Mapping[str, int], *, counts_down: bool = False) -> tuple[OddSetting, ...]:
    """Judge a servo's registers by name; those with which it must not be moved come first.

    One that is missing is taken to be as new. ``counts_down`` is whether its calibration says that
    it counts down with the joint angle, as a servo does whose motor and encoder are both reversed.
    """
    found = _odd(held, counts_down=counts_down)
    return tuple(sorted(found, key=lambda odd: not odd.forbids))


def mended(held: Mapping[str, int]) -> dict[Register, int]:
    """Every setting that is judged here, but for the limits: as new where it is odd, else as held.

    Stored for good it also keeps what opening the arm had set until power-off.
    """
    wanted = {row: held[row.name] for row in _JUDGED if row.name in held}
    wanted = {row: value for row, value in wanted.items() if row.lower <= value <= row.upper}
    for odd in odd_settings(held):
        wanted |= {row: value for row, value in odd.as_new.items() if row in _JUDGED}
    return wanted


def _odd(held: Mapping[str, int], *, counts_down: bool) -> Iterator[OddSetting]:
    phase = held.get("phase", 12)
    turned = phase & reg.REVERSED
    if turned and not (counts_down and turned == reg.REVERSED):
        yield OddSetting(
            f"it drives or counts backwards (phase register {phase}; a new servo has 12)",
            {reg.PHASE: _sound(phase) & ~reg.REVERSED},
            forbids=True,
        )
    elif phase & reg.MULTI_TURN:
        text = f"it counts more than one turn (phase register {phase}; a new servo has 12)"
        yield OddSetting(text, as_new={reg.PHASE: _sound(phase)}, is_adapted=True)
    elif phase != _sound(phase):
        text = (
            f"it turns 50 times as fast as it is told, or takes 0 for a standstill (phase register"
            f" {phase}; a new servo has 12)"
        )
        yield OddSetting(text, as_new={reg.PHASE: _sound(phase)}, is_adapted=True)
    kind = type_of(reg.PRESENT_VOLTAGE.scale * held.get("present_voltage", 120))
    strength = kind.torque_per_volt * kind.volts
    holds_with = 100.0 * _ELBOW_HOLDS / strength if held.get("id") == 3 else _OTHERS_HOLD
    for rows, is_adapted in ((PROTECTING, False), (ADAPTED, True)):
        for row in rows:
            value = held.get(row.register.name, row.as_new)
            # After an overload it drives with what register 34 says.
            most = max(value, held.get("protective_torque", 20))
            sinks = row.register is reg.OVERLOAD_TORQUE and most < holds_with
            if sinks or not row.lowest <= value <= row.highest:
                yield OddSetting(
                    row.sentence.format(value) + (", too little to hold the arm" if sinks else ""),
                    {row.register: row.as_new},
                    is_adapted=is_adapted,
                    forbids=sinks or (row.register is reg.PROTECTION_CURRENT and value in _TRIPS),
                )
    most = held.get("max_torque", 1000)
    needed = _LEAST_TORQUE.get(held.get("id", 0), _ELSEWHERE)
    if most < round(1000 * needed / strength):
        yield OddSetting(
            f"its largest torque is {most} of 1000", {reg.MAX_TORQUE: 1000}, forbids=True
        )
    hottest = held.get("max_temperature", 70)
    if not 60 <= hottest <= 80:
        yield OddSetting(
            f"it switches off at {hottest} °C; a new servo at 70",
            {reg.MAX_TEMPERATURE: 70},
            forbids=hottest < held.get("present_temperature", 0) + 5,
        )
    unloading = held.get("unloading_condition", PROTECTIONS)
    if unloading & PROTECTIONS != PROTECTIONS:
        yield OddSetting(
            "its protection against heat or overload is switched off",
            {reg.UNLOADING: unloading | PROTECTIONS},
        )
    p_gain, d_gain, i_gain = (held.get(row.name, new) for row, new in _GAINS.items())
    if p_gain < _SOFTEST or i_gain > _MOST_I:
        yield OddSetting(
            f"its gains are P {p_gain}, D {d_gain}, I {i_gain}, which cannot be meant; a new"
            " servo has 32, 32, 0",
            _GAINS,
            is_adapted=True,
        )
    top = held.get("max_acceleration", 0)
    if 0 < top < TOP_ACCELERATION_UNITS:
        yield OddSetting(
            f"its highest acceleration is {top} x 100 tick/s^2, so it falls behind",
            {reg.MAX_ACCELERATION: TOP_ACCELERATION_UNITS},
            is_adapted=True,
        )
    lower, upper = held.get("min_position", 0), held.get("max_position", 4095)
    if lower >= upper:
        yield OddSetting(
            f"its limits {lower} to {upper} leave it no travel",
            {reg.MIN_POSITION: 0, reg.MAX_POSITION: reg.TICKS_PER_TURN - 1},
            is_adapted=True,
        )


def _sound(phase: int) -> int:
    return phase & ~reg.MULTI_TURN | reg.SPEED_BITS
