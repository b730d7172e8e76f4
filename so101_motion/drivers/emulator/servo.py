"""One virtual STS3215: carries out instructions on its registers and its drive.

A write changes the memory first (``memory.py`` decides which bytes and for how long). Then this
file does what the written registers trigger, in the firmware's order: homing offset, mode, torque,
and last acceleration, speed and goal. A read updates the measured registers just before it copies
them. Position and set-point (56 and 67) are the exception: a servo measures them once in a control
period, so right after a change of mode or homing offset they are still what they were before.

A written goal starts the profile and switches torque on by itself. Reports disagree about the
torque (the factory image switches it on, one bench saw that it did not), so ``goal_enables_torque``
can turn that off: then goals that reach a limp servo do nothing.

In speed and PWM mode a servo turns at the value of its register as soon as that is written; in step
mode it turns by as many ticks as its goal says. How these modes are controlled (the position loop
follows a set-point that moves on) is chosen; the recordings are of the position mode alone.

Sources: as in ``registers.py``; what a write triggers: github.com/0o8o0-blip/sts3215-firmware,
uart_subsys.c and pid_motor.c (behaviour only).
"""

from __future__ import annotations

import math
import random
from collections.abc import Mapping

from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.codec import Code
from so101_motion.drivers.emulator.drive import Drive
from so101_motion.drivers.emulator.electric import BROWN_OUT
from so101_motion.drivers.emulator.joint_figures import TICKS_PER_RAD, Joint
from so101_motion.drivers.emulator.memory import Memory
from so101_motion.drivers.emulator.motion import DT
from so101_motion.drivers.emulator.register_values import (
    OF_FRAME,
    goal_of,
    plan_profile,
    settings_from,
    show_measurements,
    triggers_of,
)
from so101_motion.drivers.emulator.registers import TICKS_PER_TURN, Register
from so101_motion.drivers.servo_types import ServoType

BOOT_TIME = 0.8
"""From reset to the first answer [s] (the bootloader waits for an update first)."""

_CENTRE_HERE = 128  # written to register 40: "this is the middle"
_CENTRE = 2048


class Servo:
    """A servo in its joint.

    Args:
        joint: Its joint.
        kind: Its type.
        q: Joint angle to start at [rad].
        factory: EEPROM values that differ from the table's defaults, by row.
        goal_enables_torque: Whether writing a goal switches torque on.
        dither: How far position readings scatter [tick].

    Attributes:
        joint: Its joint.
        memory: Its registers.
        drive: Its controller, motor and shaft.
        connected: False while its cable is unplugged: no power, no answers.
        boot_at: When a starting servo will be up, on the emulator's clock [s], else None.
        now: When the instruction came that it carries out, on the same clock [s].
    """

    def __init__(
        self,
        joint: Joint,
        kind: ServoType,
        *,
        q: float = 0.0,
        factory: Mapping[Register, int] | None = None,
        goal_enables_torque: bool = True,
        dither: int = 0,
    ) -> None:
        self.joint = joint
        self._dither, self._random = dither, random.Random(joint.name)
        self.goal_enables_torque = goal_enables_torque
        self._top_speed = kind.speed_limit * TICKS_PER_RAD
        self.memory = Memory(factory)
        self.drive = Drive(joint, kind, q, settings_from(self.memory))
        self.connected = True
        self.now = -math.inf
        self.boot()

    # -- power ----------------------------------------------------------------------------------

    def boot(self) -> None:
        """Complete power-up: RAM at its defaults, EEPROM as saved, turn count zero."""
        self.boot_at: float | None = None
        self.memory.boot()
        self._pending = b""
        self._measures_from = -math.inf
        self._mode = self.memory.value(reg.MODE)
        self.drive.powered = True
        self.drive.settings = settings_from(self.memory)
        self.drive.restart(offset=reg.decode_offset(self.memory.raw(reg.OFFSET)))
        self._plan_profile()

    def power_off(self) -> None:
        """Become limp and silent until ``boot``."""
        self.boot_at = None
        self.drive.powered = False
        self.drive.halt()

    def follow_power(self, now: float) -> None:
        """Switch off or start with the supply, and finish a start that is due."""
        supplied = self.connected and self.drive.volts >= BROWN_OUT
        if not supplied:
            if self.drive.powered or self.boot_at is not None:
                self.power_off()
        elif not self.drive.powered:
            if self.boot_at is None:
                self.boot_at = now + BOOT_TIME
            if now >= self.boot_at:
                self.boot()

    # -- the wire -------------------------------------------------------------------------------

    @property
    def servo_id(self) -> int:
        """The id it answers to."""
        return self.memory.raw(reg.ID)

    @property
    def baud(self) -> int:
        """The baud rate it hears."""
        return reg.BAUDS[self.memory.value(reg.BAUD)]

    @property
    def status(self) -> int:
        """The status byte of its replies."""
        return self.drive.guard.flags

    @property
    def acknowledges(self) -> bool:
        """Whether it answers instructions other than ping and read."""
        return self.memory.raw(reg.STATUS_LEVEL) != 0

    def execute(self, code: int, params: bytes, now: float) -> bytes | None:
        """Carry out an instruction other than sync read and sync write.

        Returns:
            The data of the reply (empty in an acknowledgement), or None for silence.
        """
        match code:
            case Code.PING:
                return b""
            case Code.READ:
                return self.read(*params) if len(params) == 2 else None
            case Code.REBOOT:
                self.power_off()
                self.boot_at = now + BOOT_TIME
                return None
            case Code.WRITE:
                self.write(params)
            case Code.REG_WRITE:
                self._pending = params
            case Code.ACTION:
                pending, self._pending = self._pending, b""
                self.write(pending)
            case Code.CALIBRATE:
                self._calibrate(params)
            case Code.CLEAR_TURNS:
                self._clear_turns()
            case Code.RESTORE_DEFAULTS:
                self.memory.restore()
                self.boot()
            case Code.SAVE_BACKUP:
                self.memory.save_backup()
            case _:
                pass  # an unknown instruction is acknowledged like any other
        return b"" if self.acknowledges else None

    def read(self, address: int, count: int) -> bytes | None:
        """The bytes of a READ, measured now."""
        scatter = self._random.randint(-self._dither, self._dither) if self._dither else 0
        but = OF_FRAME if self.now < self._measures_from else ()
        show_measurements(self.memory, self.drive, address, count, scatter=scatter, but=but)
        self.memory.set(reg.PENDING, 1 if self._pending else 0)
        return self.memory.read(address, count)

    def write(self, params: bytes) -> None:
        """Carry out a WRITE of an address and data, and what it triggers."""
        if len(params) < 2:
            return
        triggers = triggers_of(params[0], min(params[0] + len(params) - 1, reg.SIZE))
        if triggers.offset or triggers.mode:
            self._keep_frame()
        self.memory.write(params[0], params[1:])
        self.drive.wake()
        if triggers.offset:
            turns = self.drive.position // TICKS_PER_TURN
            offset = reg.decode_offset(self.memory.raw(reg.OFFSET))
            self.drive.set_homing_offset(offset, turns=turns)
            self.drive.halt()
        if triggers.mode:
            self._change_mode()
        if triggers.settings:
            self.drive.settings = settings_from(self.memory)
        if triggers.torque:
            self._switch_torque()
        if triggers.profile:
            self._plan_profile()
        if self._mode in triggers.goal_of_modes:
            self._start_goal()

    def _keep_frame(self) -> None:
        """Measure position and set-point as they are, once more before they are shifted (FW)."""
        for row in OF_FRAME:
            self.read(row.address, row.size)
        self._measures_from = self.now + DT

    def _plan_profile(self) -> None:
        plan_profile(self.memory, self.joint, self.drive.profile, top_speed=self._top_speed)

    # -- what writes trigger ---------------------------------------------------------------------

    def _start_goal(self) -> None:
        """Drive to the goal that was written."""
        drive = self.drive
        if drive.torque != 1 and not self.goal_enables_torque:
            return
        if drive.torque != 1:
            drive.halt()
            drive.torque = 1
        drive.send(goal_of(self.memory, top_speed=self._top_speed))

    def _switch_torque(self) -> None:
        wanted = self.memory.raw(reg.TORQUE_ENABLE)
        if wanted == _CENTRE_HERE:
            self._calibrate(b"")
            wanted = 0
        if wanted != self.drive.torque:
            self.drive.torque = wanted
            self.drive.halt()
            if wanted == 1 and self._mode in (reg.SPEED_MODE, reg.PWM_MODE):
                self.drive.send(goal_of(self.memory, top_speed=self._top_speed))

    def _change_mode(self) -> None:
        mode = self.memory.value(reg.MODE)
        if mode == self._mode:
            return
        self._mode = mode
        self.memory.set(reg.ACCELERATION, 0)
        self.memory.set(reg.GOAL_VELOCITY, 0)
        self.drive.torque = 0
        self._clear_turns()
        self._plan_profile()

    def _clear_turns(self) -> None:
        offset = reg.decode_offset(self.memory.raw(reg.OFFSET))
        self.drive.set_homing_offset(offset, turns=0)
        self.drive.torque = 0
        self.drive.halt()

    def _calibrate(self, params: bytes) -> None:
        """Choose and save the homing offset that makes the present position the wanted one."""
        if len(params) not in (0, 2):
            return
        wanted = int.from_bytes(params, "little", signed=True) if params else _CENTRE
        if not -TICKS_PER_TURN < wanted < TICKS_PER_TURN:
            return
        self._keep_frame()
        offset = self.drive.encoder % TICKS_PER_TURN - wanted
        self.memory.keep(reg.OFFSET, reg.encode_offset(offset))
        self.drive.set_homing_offset(offset, turns=0)
        self.drive.halt()
