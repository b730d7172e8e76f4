"""The controller, motor, gears and protections of one emulated servo, without its registers.

``run`` is some milliseconds of control and mechanics; ``slow_step`` updates current, heat,
protections and measured speed. A drive whose whole state has not changed for a while is ``quiet``:
another step would change nothing, bit for bit, so it is left out until a setting or the load
changes and ``wake`` is called.

Positions are the servo's own: encoder ticks minus the homing offset, unwrapped since boot. While
torque is off the set-point stays on the present position, so switching it on holds the joint where
it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor

from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.electric import Motor
from so101_motion.drivers.emulator.joint_figures import TICKS_PER_RAD, Joint
from so101_motion.drivers.emulator.mechanics import Shaft
from so101_motion.drivers.emulator.motion import DT, Gains, GoalDelay, Loop, Profile, duty_table
from so101_motion.drivers.emulator.protection import Guard, Limits
from so101_motion.drivers.emulator.registers import TICKS_PER_TURN
from so101_motion.drivers.servo_types import ServoType

_SPEED_WINDOW = 0.020  # [s], the servo's own speed is an encoder difference over it
_SPEED_QUANTUM = 50  # [tick/s], one tick in that window
_QUIET_AFTER = 5  # unchanged inspections in a row; 5 ms each, longer than the usual D window


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Settings of the drive, from the registers.

    Goals are clamped to ``span`` [tick], unless its ends are equal. ``drive_sign`` is -1 if the
    motor is wired the other way round; ``encoder_reversed`` is whether the encoder counts down.
    """

    gains: Gains
    limits: Limits
    mode: int
    span: tuple[int, int]
    drive_sign: float
    encoder_reversed: bool


class Drive:
    """Controller, motor and shaft of one servo, whose joint starts at ``q`` [rad].

    Attributes:
        powered: Whether the electronics run; if not, the shaft is free.
        torque: 0 limp, 1 driven, 2 damped by its shorted motor.
        load: External torque on the output, positive towards higher ticks [N m].
        volts: Voltage on the cable [V].
        duty: Duty of the motor now, -0.97..0.97.
        demand: Last output of the loop, as far as the protections allow [1/1000].
        speed: As the servo measures it [tick/s].
        moving: Its moving flag.
        quiet: Whether stepping would change nothing.
    """

    def __init__(self, joint: Joint, kind: ServoType, q: float, settings: Settings) -> None:
        self._joint = joint
        lower, upper = sorted((self.to_ticks(joint.lower), self.to_ticks(joint.upper)))
        self.shaft = Shaft(
            kind, inertia=joint.inertia, lower=lower, upper=upper,
            at=self.to_ticks(q),
        )  # fmt: skip
        self.motor = Motor(kind)
        self.profile = Profile()
        self.loop = Loop(settings.gains)
        self.guard = Guard(settings.limits)
        self.powered = True
        self.load, self.volts = 0.0, kind.volts
        self.settings = settings
        self._goals = GoalDelay(kind.goal_delay)
        self._shape = duty_table(kind.duty_shape)
        self._duties = [0.0] * (round(kind.loop_delay / DT) + 1)  # the last ones, oldest first
        self.restart(offset=0)

    def restart(self, *, offset: int) -> None:
        self._blocked = self._capped = False
        self._may_integrate = True
        self.guard.reset()
        self.set_homing_offset(offset, turns=0)
        self.torque = 0
        self.halt()
        self.speed, self.moving = 0, False
        self._speed_since, self._speed_from = 0.0, self.position

    def wake(self) -> None:
        self.quiet = False
        self._unchanged = 0
        self._seen: tuple[float, ...] = ()

    @property
    def settings(self) -> Settings:
        return self._settings

    @settings.setter
    def settings(self, settings: Settings) -> None:
        self._settings = settings
        self._follows = settings.mode == reg.POSITION_MODE
        self._drive_sign = settings.drive_sign
        self._counts, self._zero = (-1, TICKS_PER_TURN - 1) if settings.encoder_reversed else (1, 0)
        self.loop.gains, self.guard.limits = settings.gains, settings.limits
        self.wake()

    # -- angles ---------------------------------------------------------------------------------

    def to_ticks(self, q: float) -> float:
        """Shaft angle [tick] at a joint angle [rad]."""
        return self._joint.zero_ticks + self._joint.direction * q * TICKS_PER_RAD

    @property
    def q(self) -> float:
        """True joint angle [rad]."""
        ticks = self.shaft.output - self._joint.zero_ticks
        return self._joint.direction * ticks / TICKS_PER_RAD

    @property
    def encoder(self) -> int:
        """Encoder count, unwrapped [tick]."""
        return self._counts * floor(self.shaft.output + 0.5) + self._zero

    @property
    def position(self) -> int:
        """Encoder minus homing offset, unwrapped [tick]."""
        return self._counts * floor(self.shaft.output + 0.5) + self._zero - self._origin

    def set_homing_offset(self, offset: int, *, turns: int) -> None:
        """Set the homing offset [tick] and the servo's turn count."""
        encoder = self.encoder
        here = (encoder - offset) % TICKS_PER_TURN
        self._origin = encoder - here - turns * TICKS_PER_TURN
        self._speed_from = self._inspected_at = self.position

    # -- time -----------------------------------------------------------------------------------

    def halt(self) -> None:
        self._forget()
        self.loop.reset()
        self.wake()

    def _forget(self) -> None:
        self.duty, self.demand = 0.0, 0
        self._duties = [0.0] * len(self._duties)
        self._goals.clear()
        self._wanted = 0.0
        self.profile.seed(self.position)

    def send(self, goal: float) -> None:
        """Follow a goal after the delay of the firmware.

        In position mode it is a position, in step mode a further distance [tick], in speed mode a
        speed [tick/s], in PWM mode a duty [1/1000].
        """
        self._goals.put(goal)
        self.wake()

    def step(self) -> None:
        self.run(1)

    def run(self, steps: int) -> None:
        """So many milliseconds of control and mechanics, at the same load, supply and settings."""
        shaft, load = self.shaft, self.load
        if self.torque != 1 or not self.powered or self._blocked:
            bridge = self.powered and self.torque in (1, 2)
            for _ in range(steps):
                self._forget()
                shaft.step(0.0, bridge=bridge, load=load)
            return
        goals, profile, loop, integrate = self._goals, self.profile, self.loop, self._may_integrate
        waiting, duties, shape = goals.waiting, self._duties, self._shape
        counts, zero = self._counts, self._zero - self._origin
        follows, capped, cap = self._follows, self._capped, self.guard.limits.protective_duty
        sign, volts = self._drive_sign, self.volts
        demand, duty = self.demand, self.duty
        for _ in range(steps):
            goal = goals.step() if waiting else None
            if follows:
                if goal is not None:
                    profile.target = goal
                if profile.position != profile.target or profile.velocity != 0.0:
                    profile.step()
                position = counts * floor(shaft.output + 0.5) + zero  # as ``position``
                demand = loop.step(int(profile.position) - position, integrate=integrate)
            else:
                demand = self._other_demand(goal)
            if capped:
                demand = max(min(demand, cap), -cap)
            duties.append(shape[demand])
            duty = duties.pop(0) * sign
            shaft.step(duty * volts, bridge=True, load=load)
        self.demand, self.duty = demand, duty

    def _other_demand(self, goal: float | None) -> int:
        profile, mode = self.profile, self._settings.mode
        if goal is not None:
            self._wanted = goal
        if mode == reg.PWM_MODE:
            limit = self._settings.gains.limit
            self.loop.output = round(max(min(self._wanted, limit), -limit))
            return self.loop.output
        if mode == reg.SPEED_MODE:
            profile.turn(self._wanted, around=self.position)
        else:
            if goal is not None:
                lower, upper = self._settings.span
                profile.target += goal
                if lower != upper:
                    profile.target = max(min(profile.target, upper), lower)
            profile.step()
        error = int(profile.position) - self.position
        return self.loop.step(error, integrate=self._may_integrate)

    def slow_step(self, dt: float) -> None:
        """Update current, heat, protections and measured speed after ``dt`` seconds."""
        shaft = self.shaft
        self.motor.advance(dt, duty=self.duty, volts=self.volts, velocity=shaft.velocity)
        if self.powered:
            self._check(dt)
            self._measure(dt)
        if shaft.velocity != 0.0:
            self.wake()
            return
        profile = self.profile
        seen = (
            *(shaft.output, profile.position, profile.target),
            *(self.loop.integral, self.demand, self.duty),
        )
        self._unchanged = self._unchanged + 1 if seen == self._seen else 0
        self._seen = seen
        wait = max(_QUIET_AFTER, self._settings.gains.window // 5 + 1)
        self.quiet = self._unchanged >= wait and not self._goals.waiting

    def _check(self, dt: float) -> None:
        position = self.position
        moved = position - self._inspected_at
        self._inspected_at = position
        trips = self.guard.check(
            dt,
            demand=self.loop.output,
            moved=moved,
            current=self.motor.current,
            temperature=int(self.motor.temperature),
            decivolts=int(self.volts * 10.0 + 0.5),
            torque=self.torque,
        )
        if trips:
            self.torque = 0
            self.halt()
        if not (self.guard.flags or self._blocked or self._capped):
            return
        acts = self.guard.acts
        if acts(reg.OVERHEATED | reg.VOLTAGE_FAULT) != self._blocked:
            self._blocked = not self._blocked
            self.halt()
        if acts(reg.OVERLOAD) != self._capped:
            self._capped = not self._capped
            self.wake()

    def _measure(self, dt: float) -> None:
        self._speed_since += dt
        if self._speed_since >= _SPEED_WINDOW - 1e-9:
            ticks = (self.position - self._speed_from) * _SPEED_WINDOW / self._speed_since
            still = abs(ticks) < self._settings.gains.still
            self.speed = 0 if still else round(ticks) * _SPEED_QUANTUM
            self._speed_since, self._speed_from = 0.0, self.position
        runs = self.torque == 1 and (self.profile.running or bool(self._goals.waiting))
        if self._settings.mode in (reg.SPEED_MODE, reg.PWM_MODE):
            runs = self.speed != 0  # only its own movement counts there (FW, adc.c)
        if runs:
            self.moving = True
        elif self.speed == 0:
            self.moving = False
        self._may_integrate = self.speed == 0 and not self.guard.acts(0xFF)
