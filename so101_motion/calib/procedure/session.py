"""Run a calibration: carry out the steps of ``steps.py`` on a lent bus.

How it works. Between ``start`` and the end of a calibration, the joints are limp and a ``Sampler``
watches them. The commands, and what each changes:

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

Commands may come from any thread and are carried out one at a time. ``view`` never waits.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial, partialmethod
from pathlib import Path
from typing import Any

from so101_motion.calib.access import BusAccess
from so101_motion.calib.procedure import jobs, journal, steps, travel
from so101_motion.calib.procedure.eeprom import HeldCalibration, write_held
from so101_motion.calib.procedure.journal import Journal, Saving
from so101_motion.calib.procedure.sampler import Sampler
from so101_motion.calib.procedure.steps import Command
from so101_motion.calib.procedure.travel_assessment import ROLL, can_be_accepted
from so101_motion.calib.procedure.view import CalibrationProgress, CalibrationView, show
from so101_motion.calib.record import record, store, zero
from so101_motion.calib.record.record import JOINTS, SERVO_IDS
from so101_motion.common.errors import CalibrationError, ConfigError, So101Error
from so101_motion.drivers.bus.registers import TICKS_PER_TURN

_log = logging.getLogger(__name__)


class Session:
    """Calibrates one arm, as often as asked.

    Args:
        calibration_file: Where it is saved; absolute, see ``store.resolve``.
        joints: The joints to calibrate; entries of the others stay.

    Attributes:
        held_before: Whether any of the joints was driven when the calibration began.
        stored: The content of the file after the last ``save``; None before.

    Raises:
        ConfigError: There is no such joint, or none at all.
    """

    def __init__(self, calibration_file: Path, joints: Collection[str] = JOINTS) -> None:
        self.calibration_file = calibration_file
        self.held_before = False
        self.stored: store.Stored | None = None
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

    def step(
        self, command: Command, access: BusAccess | None = None, *, accept: Collection[str] = ()
    ) -> CalibrationView:
        """Carry out a command; the top of this file says what each changes.

        Args:
            command: The command.
            access: The bus, for ``start``; lent until ``is_active`` is False again.
            accept: For ``stop_recording``: joints whose travel is right although it is not that of
                an SO-101, because something is mounted on them or blocks them.

        Raises:
            BusError: A servo cannot be reached; try again.
            CalibrationError: The command is not possible now, a joint must be moved on, a servo
                does not take a value, or a file cannot be written.
            ConfigError: ``accept`` names something that is not a joint.
        """
        with self._lock:
            leads = steps.step(self._progress.state, command)
            try:
                match command:
                    case Command.START:
                        assert access is not None
                        self._start(access)
                    case Command.SET_HOMING:
                        self._set_homing()
                    case Command.START_RECORDING:
                        self._start_recording()
                    case Command.STOP_RECORDING:
                        self._stop_recording(accept)
                    case Command.SAVE:
                        self.stored = self._save()
                    case Command.ABORT | Command.RESET:
                        self._abort()
            except Exception as error:
                self._set(state=leads.otherwise, error=str(error))
                raise
            self._set(state=leads.then, error=None)
            return self.view

    start = partialmethod(step, Command.START)
    set_homing = partialmethod(step, Command.SET_HOMING)
    start_recording = partialmethod(step, Command.START_RECORDING)
    stop_recording = partialmethod(step, Command.STOP_RECORDING)
    abort = partialmethod(step, Command.ABORT)
    reset = partialmethod(step, Command.RESET)

    def save(self) -> store.Stored:
        """Save the new calibration to servos and file; returns the content of the file."""
        self.step(Command.SAVE)
        assert self.stored is not None
        return self.stored

    def let_go(self) -> None:
        """Switch the torque of all servos off that answer, in any state of a calibration.

        Raises:
            BusError: A servo cannot be reached; try again.
        """
        with self._lock:
            self._lent().call(jobs.let_go)

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

    def _start(self, access: BusAccess) -> None:
        was_held = self.is_active and self.held_before
        self._leave()
        self._access = access
        try:
            self._put_back()
            note = access.call(partial(journal.recover, calibration_file=self.calibration_file))
            found = access.call(partial(jobs.find, joints=self.joints))
            self._set(joints=found, note=note)
            self.held_before = was_held or any(known.driven for known in found.values())
            access.call(partial(jobs.release, joints=self.joints))
        except Exception:
            if self._journal is None:
                self._leave()  # nothing that would have to be put back
            raise
        self._sampler = Sampler(access.clock, self.joints)
        self._set(recorded_for=0.0)
        access.watch(self._sampler)

    def _set_homing(self) -> None:
        access, known = self._lent(), self._progress.joints
        positions = access.call(partial(jobs.read_positions, joints=self.joints))
        encoders = {joint: known[joint].held.homing_offset + positions[joint] for joint in known}
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
        access.call(partial(jobs.check_homed, homes=homes))
        for joint, home in homes.items():
            self._know(joint, home=home)

    def _start_recording(self) -> None:
        access, sampler = self._lent(), self._sampler
        assert sampler is not None
        access.call(lambda _: sampler.record())
        self._set(started_at=access.clock.now(), recorded_for=None)

    def _stop_recording(self, accept: Collection[str]) -> None:
        access, sampler = self._lent(), self._sampler
        assert sampler is not None
        accepted, arcs = _in_order("accept", accept), sampler.seen.arcs
        if wrong := record.misplaced((), {joint: arc.travel for joint, arc in arcs.items()}):
            raise CalibrationError(None, wrong, record.NEW_IDS)
        assessments = {
            joint: known.assess(arcs.get(joint)) for joint, known in self._progress.joints.items()
        }
        meant = [
            joint
            for joint in accepted
            if joint in arcs and can_be_accepted(assessments[joint].verdict, arcs[joint].travel)
        ]
        left = {
            joint: assessment.sentence
            for joint, assessment in assessments.items()
            if not assessment.is_usable and joint not in meant
        }
        if left:
            raise _must_move_on(left)
        for joint, known in list(self._progress.joints.items()):
            fit = known.fitted(arcs.get(joint), assessments[joint])
            self._know(joint, fit=fit, assessment=replace(assessments[joint], is_usable=True))
        self._set(recorded_for=access.clock.now() - self._progress.started_at)

    def _save(self) -> store.Stored:
        access = self._lent()
        saving = self._saving()
        record.check(saving.calibration)
        access.call(partial(jobs.require, joints=self.joints))
        assert self._journal is not None
        self._note_down(replace(self._journal, saving=saving, is_decided=True))
        self._write(
            {joint: HeldCalibration.of(entry) for joint, entry in saving.calibration.items()}
        )
        stored = store.save(self.calibration_file, saving.calibration, zeros=saving.zeros)
        journal.remove(self.calibration_file)
        self._journal = None
        self._leave()
        return stored

    def _abort(self) -> None:
        self._put_back()
        self._leave()
        for joint in self._progress.joints:
            self._know(joint, home=None, fit=None, assessment=None)
        self._set(recorded_for=0.0)

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
        if self._journal is None or journal.read(self.calibration_file) is None:
            self._journal = None
            return
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
        access = self._lent()
        for joint, held in wanted.items():
            access.call(partial(write_held, servo_id=SERVO_IDS[joint], wanted=held))
            self._know(joint, held=held)

    def _lent(self) -> BusAccess:
        assert self._access is not None  # the table has commands that need it after a start only
        return self._access

    def _leave(self) -> None:
        """Give up the bus, which is not needed any more."""
        access, self._access, self._sampler = self._access, None, None
        if access is not None:
            with contextlib.suppress(So101Error):  # it may have been taken from us
                access.watch(None)

    def _set(self, **changes: Any) -> None:
        self._progress = replace(self._progress, **changes)

    def _know(self, joint: str, **changes: Any) -> None:
        joints = self._progress.joints
        self._set(joints={**joints, joint: replace(joints[joint], **changes)})


def _in_order(key: str, joints: Collection[str]) -> tuple[str, ...]:
    """The joints in order, base to jaw."""
    for joint in joints:
        if joint not in JOINTS:
            raise ConfigError(key, joint, f"must be one of {', '.join(JOINTS)}")
    return tuple(joint for joint in JOINTS if joint in joints)


def _must_move_on(left: Mapping[str, str]) -> CalibrationError:
    """The error that keeps a recording from ending: a sentence for each unfinished joint."""
    if len(left) == 1:
        ((joint, sentence),) = left.items()
        return CalibrationError(joint, sentence, "the recording goes on; then stop it again")
    reason = "; ".join(f"{joint}: {sentence}" for joint, sentence in left.items())
    return CalibrationError(None, reason, "the recording goes on; then stop it again")
