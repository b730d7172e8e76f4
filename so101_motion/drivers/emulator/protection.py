"""Model the servo's protections: overload, over-current, heat and voltage.

How it works
    ``check`` runs every few milliseconds and keeps the status byte that travels in every reply.
    Register 19 masks what a fault *does*; the bit is set either way. A fault never silences the
    servo, and a write it answers with a fault bit was executed.

    ========== ============================== ========================= ==========================
    fault      comes                          does (if masked in)       goes
    ========== ============================== ========================= ==========================
    overload   |demand| > reg 36 for reg 35   duty held to reg 34:      when the demand in the
               without 50 ticks of movement   the arm sags, not limp    stalled direction drops
                                                                        under reg 34, or torque
                                                                        is no longer 1
    current    >= reg 28 for reg 38           torque off                when low while torque is 1
    heat       > reg 13 for 50 ms             no duty, goal forgotten   5 degC below the limit
    voltage    < reg 15 at once, > reg 14     no duty, goal forgotten   back inside the limits
               for 51 ms                      (not masked in at birth)
    ========== ============================== ========================= ==========================

    Overload depends on the output that the loop *demands*, so moving the goal back to the present
    position clears it, without a power cycle.

Source: Feetech STS memory table; github.com/0o8o0-blip/sts3215-firmware, pid.c and motion.c
(behaviour only).
"""

from __future__ import annotations

from dataclasses import dataclass

from so101_motion.drivers.emulator import registers as reg

_MOVED = 50  # [tick]
_HOT_AFTER = 0.050  # [s]
_COOLER_BY = 5  # [degC]
_HIGH_AFTER = 0.051  # [s]
CURRENT_UNIT = 0.0065
"""One count of the current registers [A]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """The protection registers as numbers, SI but for duty (thousandths) and degrees Celsius."""

    mask: int
    overload_duty: int
    overload_time: float
    protective_duty: int
    current: float
    current_time: float
    temperature: int
    volts_low: int
    volts_high: int


class Guard:
    """Timers and fault flags of one servo's protections.

    Attributes:
        flags: The status byte.
        limits: Replaced whole when a protection register is written.
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.reset()

    def reset(self) -> None:
        self.flags = 0
        self._stalled = 0  # direction of the stall that is being timed, or 0
        self._moved = 0
        self._stall_time = self._current_time = self._heat_time = self._high_time = 0.0

    def acts(self, fault: int) -> bool:
        """Whether a fault is present and masked in."""
        return bool(self.flags & self.limits.mask & fault)

    @property
    def timing(self) -> bool:
        """Whether some timer runs, so that the next check should come soon."""
        waiting = self._stall_time + self._current_time + self._heat_time + self._high_time
        return waiting > 0.0 and not self.flags

    def check(
        self,
        dt: float,
        *,
        demand: int,
        moved: int,
        current: float,
        temperature: int,
        decivolts: int,
        torque: int,
    ) -> bool:
        """Update the flags after ``dt`` [s]; return whether torque must go off (over-current).

        ``demand`` is the output of the loop in thousandths, ``moved`` how far the output moved
        meanwhile [tick], ``current`` that of the bridge [A], ``torque`` register 40.
        """
        limits = self.limits
        if (
            not (self.flags or self._stalled or self.timing)
            and -limits.overload_duty <= demand <= limits.overload_duty
            and temperature <= limits.temperature
            and limits.volts_low <= decivolts <= limits.volts_high
            and -limits.current < current < limits.current
        ):
            return False  # nothing is the matter, as nearly always
        self._overload(dt, demand, moved, torque)
        self._heat(dt, temperature)
        self._voltage(dt, decivolts)
        return self._overcurrent(dt, current, torque)

    def _set(self, fault: int, present: bool) -> None:
        self.flags = self.flags | fault if present else self.flags & ~fault

    def _overload(self, dt: float, demand: int, moved: int, torque: int) -> None:
        limits = self.limits
        if self.flags & reg.OVERLOAD and torque != 1:
            self._set(reg.OVERLOAD, False)
            self._stalled = 0
        if not self._stalled:
            if abs(demand) <= limits.overload_duty:
                self._stall_time = 0.0
                return
            self._stalled = 1 if demand > 0 else -1
            self._moved, self._stall_time = 0, 0.0
        if not self.flags & reg.OVERLOAD:
            self._moved += moved
            self._stall_time += dt
            if abs(self._moved) > _MOVED:
                self._stalled, self._stall_time = 0, 0.0
                return
            self._set(reg.OVERLOAD, self._stall_time > limits.overload_time)
        if demand * self._stalled < limits.protective_duty:
            self._stalled, self._stall_time = 0, 0.0
            self._set(reg.OVERLOAD, False)

    def _overcurrent(self, dt: float, current: float, torque: int) -> bool:
        limits = self.limits
        if not limits.current or not limits.current_time:
            self._set(reg.OVERCURRENT, False)
            return False
        if abs(current) < limits.current:
            self._current_time = 0.0
            if torque == 1:
                self._set(reg.OVERCURRENT, False)
            return False
        self._current_time += dt
        if self._current_time <= limits.current_time:
            return False
        self._set(reg.OVERCURRENT, True)
        return self.acts(reg.OVERCURRENT)

    def _heat(self, dt: float, temperature: int) -> None:
        if self.flags & reg.OVERHEATED:
            self._heat_time = 0.0
            if temperature + _COOLER_BY < self.limits.temperature:
                self._set(reg.OVERHEATED, False)
        elif temperature > self.limits.temperature:
            self._heat_time += dt
            self._set(reg.OVERHEATED, self._heat_time > _HOT_AFTER)
        else:
            self._heat_time = 0.0

    def _voltage(self, dt: float, decivolts: int) -> None:
        if decivolts <= self.limits.volts_high:
            self._high_time = 0.0
            self._set(reg.VOLTAGE_FAULT, decivolts < self.limits.volts_low)
            return
        self._high_time += dt
        if self._high_time > _HIGH_AFTER:
            self._set(reg.VOLTAGE_FAULT, True)
