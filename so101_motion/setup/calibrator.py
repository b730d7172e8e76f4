"""Calibrate and set up motors on a serial port that an arm may be using at the same time.

The bus is borrowed when a calibration starts, and for each request of the motor setup. When the
calibration ends it is given back with the result in force: after a save the new calibration, with
the joints held where they are; else the former one, with the joints held if they were before.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from so101_motion.calib.access import BusAccess
from so101_motion.calib.motors.setup_view import SetupView, Verification
from so101_motion.calib.procedure import eeprom
from so101_motion.calib.procedure.session import Session
from so101_motion.calib.procedure.steps import Command, State
from so101_motion.calib.procedure.view import CalibrationView, JointView
from so101_motion.calib.record import record, store
from so101_motion.calib.record.record import JOINTS, SERVO_IDS
from so101_motion.calib.record.store import Stored
from so101_motion.calib.record.zero import expected_travel
from so101_motion.common.errors import CalibrationError, So101Error
from so101_motion.common.modes import Mode
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.common.units import to_deg
from so101_motion.drivers.bus.defaults import BAUDRATE
from so101_motion.drivers.bus.registers import TICKS_PER_TURN
from so101_motion.drivers.bus.ticks import RAD_PER_TICK, Ticks
from so101_motion.rig.bus_lease import BusLease
from so101_motion.rig.hardware_rig import HardwareRig, open_hardware
from so101_motion.rig.joint_setup import JointSetup
from so101_motion.rig.port_settings import ServoSettings
from so101_motion.setup.motor_operation import ChainOperation, MotorOperation

PUT_BACK = "the motors have their previous settings again"
"""How an aborted calibration leaves them, for people."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepResult:
    """How the end of a calibration has left the arm."""

    stored: Stored | None = None  # the content of the file now; None if nothing was saved
    holds: bool = False  # whether the joints are held now
    trouble: str | None = None  # why the arm is not held as it should be; None if it is

    @property
    def put_back(self) -> str:
        trouble = f". But: {self.trouble}" if self.trouble else ""
        return f"{PUT_BACK}; {about_torque(self.holds)}{trouble}"


def about_torque(holds: bool | None) -> str:
    """Text that says whether the joints are held; ``holds`` is None if no motor answers."""
    if holds is None:
        return "no motor answers"
    if holds:
        return "the joints are held where they stand"
    return "the joints are limp, so support the arm"


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """The state of calibration, motor setup and arm at one instant."""

    view: CalibrationView
    setup: SetupView
    # the calibrated joints, base to jaw: of the calibration under way, else of the one in force
    joints: Mapping[str, JointView]
    # their angles [rad], as far as known. From ``set_homing`` on they are counted from the middle
    # of the joint's limits, because no calibration is in force then
    angles: Mapping[str, float]
    calibration_file: str  # where a calibration is saved, absolute
    is_connected: bool
    holds: bool | None = None  # whether any joint is driven; None if no servo answers
    notes: tuple[str, ...] = ()
    # the last result of verifying the finished chain; None without one
    checked: Verification | None = None

    @property
    def saved(self) -> str | None:
        """The file of the calibration in force, if none is under way and it has all joints."""
        is_whole = bool(self.joints) and all(view.is_done for view in self.joints.values())
        return self.calibration_file if is_whole and self.view.state is State.IDLE else None

    @property
    def untouched(self) -> str:
        return f"nothing is under way, so nothing was changed; {about_torque(self.holds)}"


class Calibrator(Session):
    """Calibrates the arm on a port, and sets up its servos.

    Its commands raise ``MotionError`` as well, if something moves or the bus is lent already. It
    owns ``rig``, its share of the port, whose settings' ``calibration_file``, else their
    ``fallback_file``, is where a calibration is saved.
    """

    def __init__(self, rig: HardwareRig, joints: Collection[str] = JOINTS) -> None:
        self.rig = rig
        super().__init__(self._file(), joints)
        self.ended = StepResult()  # how the last save, abort or reset has left the arm
        self._loan: BusLease | None = None
        self.motors = MotorOperation(self._borrow)
        self.chain = ChainOperation(self.motors, is_busy=lambda: self.is_under_way)

    @classmethod
    def open(
        cls,
        port: str,
        file: Path,
        joints: Collection[str] = JOINTS,
        *,
        baudrate: int = BAUDRATE,
        open_rig: Callable[[ServoSettings], HardwareRig] = open_hardware,
    ) -> Calibrator:
        """Open a port to calibrate what is on it into ``file``; nothing is driven."""
        asked = ServoSettings(port=port, baudrate=baudrate, timeout=None, fallback_file=file)
        rig = open_rig(asked)
        try:
            return cls(rig, joints)
        except BaseException:
            rig.close()
            raise

    # Looking

    @property
    def port(self) -> str:
        return self.rig.settings.port

    @property
    def situation(self) -> Situation:
        servos, view, is_active = self.rig.servos, self.view, self.is_active
        joints = view.joints  # none yet while a start is on its way
        if not is_active or not joints:
            joints = {joint: self._at_rest(joint) for joint in self.joints}
        notes = servos.notes if view.note is None else (view.note, *servos.notes)
        return Situation(
            view=view,
            setup=self.motors.state,
            joints=joints,
            angles=self._angles(joints, is_active and view.state is not State.STARTED),
            calibration_file=str(self.calibration_file if is_active else self._file()),
            is_connected=servos.has_port,
            holds=servos.holds,
            notes=notes,
            checked=self.motors.checked,
        )

    @property
    def is_under_way(self) -> bool:
        return self.view.state is not State.IDLE

    # Calibrating

    def start(self, access: BusAccess | None = None) -> CalibrationView:
        with self._lock:
            loan = self._loan
            if loan is None:
                loan = self.rig.lend_bus("calibration")
                self.calibration_file = self._file()
            try:
                return super().start(access or loan)
            finally:
                self._loan = loan if self.is_active else None
                if self._loan is None:  # it failed, and nothing has to be put back
                    loan.abandon()

    def save(self) -> Stored:
        """Save; the arm then has the new calibration, and its joints are held where they are."""
        with self._lock:
            stored = super().save()
            self.ended = self._give_back(hold=True, stored=stored)
            return stored

    def abort(self, command: Command = Command.ABORT) -> CalibrationView:
        """Put the servos back as they were found, and hold the joints if they were held."""
        with self._lock:
            view = super().abort(command)
            self.ended = self._give_back(hold=self.held_before)
            return view

    def hold(self) -> StepResult:
        """Hold the joints where they stand, without a component as well; ends hand guiding."""
        with self._lock:
            self._refuse_active("hold the joints")
            self.rig.arm.stop()
            self._loan = self.rig.lend_bus("holding")
            return self._give_back(hold=True)

    def let_go(self) -> None:
        """Switch torque off, even if no component asks for the servos; silent ones are left out."""
        with self._lock:
            if self.is_active:
                self._lent.call(eeprom.let_go)
                return
            self.rig.arm.stop()
            self.rig.gripper.stop()
            with self._borrow("letting go") as loan:
                loan.call(eeprom.let_go)

    def restore(self, number: int | None = None) -> StepResult:
        """Restore an earlier version in file and servos, the last that differs by default."""
        with self._lock:
            self._refuse_active("go back")
            hold = self.rig.servos.is_driving or None  # or as the servos are
            self._loan = self.rig.lend_bus("an earlier calibration")
            try:
                stored = store.restore(self._file(), number)
                self._loan.call(partial(eeprom.write_calibration, stored=stored))
            except So101Error:
                self._give_back(hold=hold)
                raise
            return self._give_back(hold=hold, stored=stored)

    def close(self) -> None:
        with self._lock:
            self._end()
            self.rig.close()

    def leave(self) -> bool | None:
        """Like ``close``; returns whether any joint is driven, None if no servo answers."""
        with self._lock:
            self._end()
            try:
                with self._borrow("its end") as loan:
                    return loan.call(eeprom.is_driving)
            except So101Error:
                return None
            finally:
                self.rig.close()

    # How

    def _end(self) -> None:
        super().close()
        self._give_back(hold=self.held_before)

    def _file(self) -> Path:
        settings = self.rig.settings
        file = settings.calibration_file or settings.fallback_file
        assert file is not None  # a calibrator's settings always have one
        return file

    def _refuse_active(self, then: str) -> None:
        if self.is_active:
            raise CalibrationError(
                None, "a calibration is under way", f"save or abort it, then {then}"
            )

    def _give_back(self, *, hold: bool | None, stored: Stored | None = None) -> StepResult:
        loan, self._loan = self._loan, None
        trouble, known = None, self.rig.servos.known
        if loan is not None:
            try:
                loan.give_back(hold=hold)
            except So101Error as error:
                trouble = str(error)
        servos, mode = self.rig.servos, self.rig.arm.state.mode
        hold = servos.is_driving if hold is None else hold
        silent = [joint for joint in known if joint not in servos.setups]
        if hold and trouble is None and silent:
            trouble = (
                f"{', '.join(silent)} does not answer, so nothing holds it: check its cable, then"
                " let the arm hold"
            )
        elif hold and trouble is None and servos.limp:
            trouble = (
                f"{', '.join(servos.limp)} stands outside the range that was recorded, and is limp:"
                " move it inside by hand, then let the arm hold"
            )
        return StepResult(
            stored=stored, holds=mode is Mode.HOLDING and servos.is_driving, trouble=trouble
        )

    @contextmanager
    def _borrow(self, purpose: str = "motor setup") -> Iterator[BusAccess]:
        with self._lock:
            loan = self.rig.lend_bus(purpose)
            try:
                yield loan
            finally:
                loan.abandon()  # servos are missing during a setup, and that is no error

    def _at_rest(self, joint: str) -> JointView:
        setup = self.rig.servos.setups.get(joint)
        ticks = self._ticks(joint, setup)
        entry = record.default(joint) if setup is None else setup.calibration
        return JointView(
            joint=joint,
            servo_id=SERVO_IDS[joint],
            ticks=ticks,
            homing_offset=entry.homing_offset,
            range_min=entry.range_min,
            range_max=entry.range_max,
            expected_deg=to_deg(expected_travel(joint) * RAD_PER_TICK),
            sentence="its servo does not answer" if ticks is None else "",
            is_done=setup is not None and setup.source == "file",
        )

    def _ticks(self, joint: str, setup: JointSetup | None) -> int | None:
        servos = self.rig.servos
        if not servos.is_ours:
            ticks = servos.positions.get(joint)
            return None if ticks is None else ticks % TICKS_PER_TURN
        silent = (health.joint for health in servos.health if health.is_silent)
        if not servos.is_connected or setup is None or joint in silent:
            return None
        reading = self.rig.arm.state.reading
        q = reading.q_jaw if joint == GRIPPER_JOINT else float(reading.q[JOINTS.index(joint)])
        return setup.map.to_ticks(q) % TICKS_PER_TURN

    def _angles(self, joints: Mapping[str, JointView], by_middle: bool) -> dict[str, float]:
        setups, angles = self.rig.servos.setups, {}
        for joint, view in joints.items():
            if view.ticks is None:
                continue
            if by_middle or joint not in setups:
                middle = (view.range_min + view.range_max) / 2.0
                angles[joint] = (view.ticks - middle) * RAD_PER_TICK
            else:
                angles[joint] = setups[joint].map.to_rad(Ticks(view.ticks))
        return angles
