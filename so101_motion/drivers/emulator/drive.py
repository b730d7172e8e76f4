"""The controller, motor, gears and protections of one emulated servo, without its registers.

``step`` is one millisecond of control and mechanics; ``slow_step`` updates current, heat,
protections and measured speed. A drive whose whole state has not changed for a while is ``quiet``:
another step would change nothing, bit for bit, so it is left out until a setting or the load
changes and ``wake`` is called.

Positions are the servo's own: encoder ticks minus the homing offset, unwrapped since boot. While
torque is off the set-point stays on the present position, so switching it on holds the joint where
it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.electric import Motor
from so101_motion.drivers.emulator.hardware import TICKS_PER_RAD, Joint
from so101_motion.drivers.emulator.mechanics import Shaft
from so101_motion.drivers.emulator.motion import DT, Gains, GoalDelay, Loop, Profile, duty_table
from so101_motion.drivers.emulator.protection import Condition, Guard, Limits
from so101_motion.drivers.emulator.registers import TICKS_PER_TURN
from so101_motion.drivers.servo_types import ServoType

_SPEED_WINDOW = 0.020  # [s], the servo's own speed is an encoder difference over it
_SPEED_QUANTUM = 50  # [tick/s], one tick in that window
_QUIET_AFTER = 5  # unchanged inspections in a row; 5 ms each, longer than the usual D window


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Settings of the drive, from the registers.

    Attributes:
        gains: Of the position loop.
        limits: Of the protections.
        mode: What drives the motor, such as ``POSITION_MODE``.
        drive_sign: -1 if the motor is wired the other way round.
        encoder_reversed: Whether the encoder counts down.
    """

    gains: Gains
    limits: Limits
    mode: int
    drive_sign: float
    encoder_reversed: bool


class Drive:
    """Controller, motor and shaft of one servo.

    Args:
        joint: The servo's joint.
        kind: Its type.
        q: Joint angle to start at [rad].
        settings: Settings from its registers.

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
            kind, inertia=joint.inertia, lash=joint.lash, lower=lower, upper=upper,
            at=self.to_ticks(q),
        )  # fmt: skip
        self.motor = Motor(kind)
        self.profile = Profile()
        self.loop = Loop(settings.gains)
        self.guard = Guard(settings.limits)
        self.powered = True
        self.load, self.volts = 0.0, kind.volts
        self._settings = settings
        self._goals = GoalDelay(kind.goal_delay)
        self._shape = duty_table(kind.duty_shape)
        self._duties = [0.0] * (round(kind.loop_delay / DT) + 1)  # the last ones, newest first
        self.restart(offset=0)

    def restart(self, *, offset: int) -> None:
        """Return to the state after power-up: limp, no fault, turn count zero."""
        self._blocked = self._capped = False
        self._may_integrate = True
        self.guard.reset()
        self.set_homing_offset(offset, turns=0)
        self.torque = 0
        self.halt()
        self.speed, self.moving = 0, False
        self._speed_since, self._speed_from = 0.0, self.position

    def wake(self) -> None:
        """Step it again, because something changed."""
        self.quiet = False
        self._unchanged = 0
        self._seen: tuple[float, ...] = ()

    @property
    def settings(self) -> Settings:
        """Settings from the registers."""
        return self._settings

    @settings.setter
    def settings(self, settings: Settings) -> None:
        self._settings = settings
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
        ticks = math.floor(self.shaft.output + 0.5)
        return TICKS_PER_TURN - 1 - ticks if self._settings.encoder_reversed else ticks

    @property
    def position(self) -> int:
        """Encoder minus homing offset, unwrapped [tick]."""
        ticks = math.floor(self.shaft.output + 0.5)  # as ``encoder``: this is asked every step
        if self._settings.encoder_reversed:
            ticks = TICKS_PER_TURN - 1 - ticks
        return ticks - self._origin

    def set_homing_offset(self, offset: int, *, turns: int) -> None:
        """Set the homing offset [tick] and the servo's turn count."""
        encoder = self.encoder
        here = (encoder - offset) % TICKS_PER_TURN
        self._origin = encoder - here - turns * TICKS_PER_TURN
        self._speed_from = self._inspected_at = self.position

    # -- time -----------------------------------------------------------------------------------

    def halt(self) -> None:
        """Forget the goal, and make the present position the set-point."""
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

        Args:
            goal: A position [tick]; in speed mode a speed [tick/s], in PWM mode a duty [1/1000], in
                step mode a further distance [tick].
        """
        self._goals.put(goal)
        self.wake()

    def step(self) -> None:
        """One millisecond of control and mechanics."""
        if self.powered and self.torque == 1 and not self._blocked:
            goal = self._goals.step() if self._goals.waiting else None
            if self._settings.mode != reg.POSITION_MODE:
                demand = self._other_demand(goal)
            else:
                profile = self.profile
                if goal is not None:
                    profile.target = goal
                if profile.position != profile.target or profile.velocity != 0.0:
                    profile.step()
                error = int(profile.position) - self.position
                demand = self.loop.step(error, integrate=self._may_integrate)
            if self._capped:
                cap = self.guard.limits.protective_duty
                demand = max(min(demand, cap), -cap)
            self._duties.insert(0, math.copysign(self._shape[abs(demand)], demand))
            self.duty = self._duties.pop() * self._settings.drive_sign
            self.demand = demand
            self.shaft.step(self.duty * self.volts, bridge=True, load=self.load)
            return
        self._forget()
        self.shaft.step(0.0, bridge=self.powered and self.torque in (1, 2), load=self.load)

    def _other_demand(self, goal: float | None) -> int:
        """The demanded duty in speed, PWM or step mode."""
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
                profile.target += goal
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
        profile = self.profile
        seen = (
            shaft.output, shaft.velocity, profile.position, profile.target, self.loop.integral,
            self.duty,
        )  # fmt: skip
        self._unchanged = self._unchanged + 1 if seen == self._seen else 0
        self._seen = seen
        wait = max(_QUIET_AFTER, self._settings.gains.window // 5 + 1)
        self.quiet = shaft.velocity == 0.0 and self._unchanged >= wait and not self._goals.waiting

    def _check(self, dt: float) -> None:
        position = self.position
        condition = Condition(
            demand=self.loop.output,
            moved=position - self._inspected_at,
            current=self.motor.current,
            temperature=int(self.motor.temperature),
            decivolts=int(self.volts * 10.0 + 0.5),
            torque=self.torque,
        )
        self._inspected_at = position
        if self.guard.check(dt, condition):
            self.torque = 0
            self.halt()
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
        if self.torque == 1 and (self.profile.running or self._goals.waiting):
            self.moving = True
        elif self.speed == 0:
            self.moving = False
        self._may_integrate = self.speed == 0 and not self.guard.acts(0xFF)
