"""Run a calibration: carry out the commands of ``steps.py`` on a lent bus.

Between ``start`` and the end of a calibration, the joints are limp and a ``Sampler`` watches them.
The commands, and what each changes:

* ``start`` switches torque off. No setting is written.
* ``set_homing`` writes the journal, then each servo's homing offset, so that the pose of this
  moment reads 2047, and opens its limits. All is read back.
* ``start_recording`` and ``stop_recording`` write nothing. Stopping is refused, and the recording
  goes on, until every joint has moved through its travel.
* ``save`` checks once more what it is about to write, then commits: it writes the journal, the
  servos one after the other and the file, and then removes the journal. If that fails half-way,
  because of a loose cable or a full disk, give it again.
* ``abort`` puts the servos back as they were found; ``reset`` is the same.

So until ``save`` commits, any interruption ends with the former calibration, and after that with
the new one. After a crash, ``journal.py`` does this at the next start.

This file does not switch torque on: the lender takes the bus back and, with the goal seeded, lets
the joints hold where they are. It should do so after ``save``, and after ``abort`` if
``held_before``.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from so101_motion.calib.access import BusAccess
from so101_motion.calib.procedure import eeprom, journal, steps, travel
from so101_motion.calib.procedure.eeprom import write_held
from so101_motion.calib.procedure.journal import Journal, Saving
from so101_motion.calib.procedure.sampler import Sampler
from so101_motion.calib.procedure.steps import Command
from so101_motion.calib.procedure.travel import ROLL, can_be_accepted
from so101_motion.calib.procedure.view import (
    CalibrationProgress,
    CalibrationView,
    JointProgress,
    show,
)
from so101_motion.calib.record import record, store, zero
from so101_motion.calib.record.record import JOINTS, SERVO_IDS, HeldCalibration
from so101_motion.common.errors import CalibrationError, ConfigError, So101Error
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.registers import TICKS_PER_TURN

_log = logging.getLogger(__name__)

_REVERSED = 0x80  # bit of register 18: the encoder counts down (FT)


class Session:
    """Calibrates one arm, as often as asked. Commands of any thread are carried out one at a time.

    A command raises ``CalibrationError`` if it is not possible now, if a servo does not take a
    value or a file cannot be written; ``BusError`` if a servo cannot be reached: try again then.
    """

    def __init__(self, calibration_file: Path, joints: Collection[str] = JOINTS) -> None:
        self.calibration_file = calibration_file  # absolute, see ``store.resolve``
        self.held_before = False  # whether any of the joints was driven when it began
        self.joints = _in_order("joints", joints)
        if not self.joints:
            raise ConfigError("joints", list(joints), "name at least one")
        self._lock = threading.RLock()  # one command at a time
        self._access: BusAccess | None = None
        self._sampler: Sampler | None = None
        self._journal: Journal | None = None
        self._progress = CalibrationProgress()  # replaced whole, for ``view``

    @property
    def view(self) -> CalibrationView:
        """The state of the calibration; never waits."""
        access, sampler = self._access, self._sampler
        if access is None or sampler is None:
            return show(self._progress, None, 0.0)
        return show(self._progress, sampler.seen, access.clock.now())

    @property
    def is_active(self) -> bool:
        """Whether the bus is still needed; once it is not, give it back."""
        return self._access is not None

    # The commands

    def start(self, access: BusAccess) -> CalibrationView:
        """Begin; the bus is lent until ``is_active`` is False again."""
        with self._carried_out(Command.START):
            was_held = self.is_active and self.held_before
            self._leave()
            self._access = access
            try:
                self._put_back()
                note = access.call(partial(journal.recover, calibration_file=self.calibration_file))
                found = access.call(partial(find, joints=self.joints))
                self._set(joints=found, note=note)
                self.held_before = was_held or any(known.driven for known in found.values())
                ids = [SERVO_IDS[joint] for joint in self.joints]
                access.call(partial(eeprom.release, servo_ids=ids))
            except Exception:
                if self._journal is None:
                    self._leave()  # nothing that would have to be put back
                raise
            self._sampler = Sampler(access.clock, self.joints)
            self._set(recorded_for=0.0)
            access.watch(self._sampler)
        return self.view

    def set_homing(self) -> CalibrationView:
        """Let the pose of this moment read 2047, for good."""
        with self._carried_out(Command.SET_HOMING):
            access, known = self._lent, self._progress.joints
            positions = access.call(partial(eeprom.read_positions, joints=self.joints))
            encoders = {
                joint: known[joint].held.homing_offset + positions[joint] for joint in known
            }
            wanted = {
                joint: HeldCalibration(homing_offset=travel.homing_offset(encoder))
                for joint, encoder in encoders.items()
            }
            homes = {
                joint: (encoders[joint] - held.homing_offset) % TICKS_PER_TURN
                for joint, held in wanted.items()
            }
            before = {joint: joint_known.before for joint, joint_known in known.items()}
            self._note_down(Journal(before=before, meanwhile=wanted))
            self._write(wanted)
            access.call(partial(eeprom.check_homed, homes=homes))
            for joint, home in homes.items():
                self._know(joint, home=home)
        return self.view

    def start_recording(self) -> CalibrationView:
        with self._carried_out(Command.START_RECORDING):
            access, sampler = self._lent, self._sampler
            assert sampler is not None
            access.call(lambda _: sampler.record())
            self._set(started_at=access.clock.now(), recorded_for=None)
        return self.view

    def stop_recording(self, accept: Collection[str] = ()) -> CalibrationView:
        """End the recording.

        Args:
            accept: Joints whose travel is right although it is not that of an SO-101, because
                something is mounted on them or blocks them.
        """
        with self._carried_out(Command.STOP_RECORDING):
            sampler = self._sampler
            assert sampler is not None
            accepted, arcs = _in_order("accept", accept), sampler.seen.arcs
            if wrong := record.misplaced((), {joint: arc.travel for joint, arc in arcs.items()}):
                raise CalibrationError(None, wrong, record.NEW_IDS)
            joints = self._progress.joints
            judged = {joint: known.assess(arcs.get(joint)) for joint, known in joints.items()}
            left = {
                joint: assessment.sentence
                for joint, assessment in judged.items()
                if not assessment.is_usable
                and not (
                    joint in accepted
                    and joint in arcs
                    and can_be_accepted(assessment.verdict, arcs[joint].travel)
                )
            }
            if left:
                first = next(iter(left)) if len(left) == 1 else None
                each = "; ".join(f"{joint}: {sentence}" for joint, sentence in left.items())
                reason = each if first is None else left[first]
                step = "the recording goes on; then stop it again"
                raise CalibrationError(first, reason, step)
            for joint, known in joints.items():
                fit = known.fitted(arcs.get(joint), judged[joint])
                self._know(joint, fit=fit, assessment=replace(judged[joint], is_usable=True))
            self._set(recorded_for=self._lent.clock.now() - self._progress.started_at)
        return self.view

    def save(self) -> store.Stored:
        with self._carried_out(Command.SAVE):
            saving = self._saving()
            record.check(saving.calibration)
            self._lent.call(partial(eeprom.require, joints=self.joints))
            assert self._journal is not None
            self._note_down(replace(self._journal, saving=saving, is_decided=True))
            self._write({joint: entry.held for joint, entry in saving.calibration.items()})
            stored = store.save(self.calibration_file, saving.calibration, zeros=saving.zeros)
            journal.remove(self.calibration_file)
            self._journal = None
            self._leave()
        return stored

    def abort(self, command: Command = Command.ABORT) -> CalibrationView:
        with self._carried_out(command):
            self._put_back()
            self._leave()
            for joint in self._progress.joints:
                self._know(joint, home=None, fit=None, assessment=None)
            self._set(recorded_for=0.0)
        return self.view

    def reset(self) -> CalibrationView:
        return self.abort(Command.RESET)

    def close(self) -> None:
        """Abort a running calibration; the next start restores what is out of reach now."""
        with self._lock:
            if self._access is None:
                return
            try:
                self.abort()
            except So101Error as error:
                _log.warning("a calibration was given up half way: %s", error)
                self._leave()

    # How

    @contextlib.contextmanager
    def _carried_out(self, command: Command) -> Iterator[None]:
        with self._lock:
            leads = steps.step(self._progress.state, command)
            try:
                yield
            except Exception as error:
                self._set(state=leads.otherwise, error=str(error))
                raise
            self._set(state=leads.then, error=None)

    def _saving(self) -> Saving:
        calibration, zeros = {}, {}
        for joint, known in self._progress.joints.items():
            fit = known.fit
            assert fit is not None
            calibration[joint] = entry = replace(
                record.default(joint),
                homing_offset=fit.homing_offset,
                range_min=fit.lower,
                range_max=fit.upper,
            )
            if joint == ROLL:
                zeros[joint] = zero.by_pose(entry, fit.home, angle=zero.ROLL_UPRIGHT)
            elif (by_stops := zero.by_stops(joint, entry)) is not None:
                zeros[joint] = by_stops
        return Saving(calibration=calibration, zeros=zeros)

    def _put_back(self) -> None:
        """Restore what the servos held, unless that has been done."""
        if self._journal is not None and journal.read(self.calibration_file) is not None:
            if self._journal.is_decided:
                self._note_down(replace(self._journal, is_decided=False))
            self._write(self._journal.before)
            journal.remove(self.calibration_file)
        self._journal = None

    def _note_down(self, noted: Journal) -> None:
        """Write the journal, before anything is written for good."""
        journal.write(self.calibration_file, noted)
        self._journal = noted

    def _write(self, wanted: Mapping[str, HeldCalibration]) -> None:
        for joint, held in wanted.items():
            self._lent.call(partial(write_held, servo_id=SERVO_IDS[joint], wanted=held))
            self._know(joint, held=held)

    @property
    def _lent(self) -> BusAccess:
        assert self._access is not None  # the table has commands that need it after a start only
        return self._access

    def _leave(self) -> None:
        access, self._access, self._sampler = self._access, None, None
        if access is not None:
            with contextlib.suppress(So101Error):  # it may have been taken from us
                access.watch(None)

    def _set(self, **changes: Any) -> None:
        self._progress = replace(self._progress, **changes)

    def _know(self, joint: str, **changes: Any) -> None:
        joints = self._progress.joints
        self._set(joints={**joints, joint: replace(joints[joint], **changes)})


def find(bus: Bus, joints: Collection[str]) -> dict[str, JointProgress]:
    eeprom.require(bus, joints)
    found = {}
    for joint in joints:
        servo_id = SERVO_IDS[joint]
        held = eeprom.read_held(bus, servo_id)
        found[joint] = JointProgress(
            joint=joint,
            before=eeprom.restorable(held),
            held=held,
            driven=bus.read(servo_id, reg.TORQUE_ENABLE) == 1,
            counts_down=bool(bus.read(servo_id, reg.PHASE) & _REVERSED),
        )
    return found


def _in_order(key: str, joints: Collection[str]) -> tuple[str, ...]:
    for joint in joints:
        if joint not in JOINTS:
            raise ConfigError(key, joint, f"must be one of {', '.join(JOINTS)}")
    return tuple(joint for joint in JOINTS if joint in joints)
