"""Identifying an arm's servos as an operation: plan, move once a person agrees, keep the figures.

Planning moves nothing, and Stop ends the motions like any other. The figures are kept beside the
calibration and used at once. ``identify`` does all of it in one command, for programs.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import copy_context
from functools import partial
from typing import TYPE_CHECKING, Any

from so101_motion.calib.record import servo_file
from so101_motion.common.errors import CalibrationError, ConfigError, MotionError, NotPossibleNow
from so101_motion.common.modes import Mode
from so101_motion.common.operation import LocalOperation, Offer, Row, Started, View
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg
from so101_motion.control.request_queue import own_thread
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.request import Search
from so101_motion.rig.hardware_rig import HardwareRig

if TYPE_CHECKING:
    from so101_motion.setup.identify import Identification, IdentificationOutline, IdentifyReport

_OFF = "Measures how each servo differs from its type. The arm moves, for about three minutes."
_PLANNED = "Planned; nothing moves yet. Read what will move, then press a button below it."
_CLEAR = "Move only when nothing is in its way and nobody is near it."
_KEPT = "Saved beside the calibration and used from now on."
_NO_FILE = "the arm has no calibration file, and the figures belong beside one; calibrate it"


class IdentifyOperation(LocalOperation):
    """Identifies the servos of an arm on a port of this computer."""

    refuses = False

    def __init__(
        self,
        rig: HardwareRig,
        ready: Callable[[], Scene] | None = None,
        on_progress: Callable[[str], None] = lambda _: None,
    ) -> None:
        super().__init__()
        self._rig, self._on_progress = rig, on_progress
        self._ready = ready or (lambda: rig.arm.scene)
        self.identification: Identification | None = None
        self._outline: IdentificationOutline | None = None
        self.report: IdentifyReport | None = None
        self._doing = ""
        self._one_at_a_time = threading.Lock()
        self.commands = {"plan": self._plan, "move": self._move, "identify": self._identify}

    def close(self) -> None:
        """End what is under way; its command then raises ``Interrupted``."""
        if self.identification is not None:
            self.identification.cancel()

    @property
    def view(self) -> View:
        outline, report, doing = self._outline, self.report, self._doing
        mode = self._rig.arm.state.mode
        busy = doing or (None if mode is Mode.HOLDING else f"the arm is {mode.words}")
        no_file = _NO_FILE if self._rig.settings.file is None else None
        moves: tuple[Offer, ...] = ()
        text, note = _OFF if report is None or report.file is None else _KEPT, ""
        if report is not None:
            note = " ".join(report.remarks())
        if doing:
            text = f"{doing} … Stop ends it."
        elif outline is not None:
            left_out = (f"{joint} is left out: {why}." for joint, why in outline.obstacles)
            text, note = f"{_PLANNED} {outline.sentence}", " ".join((*left_out, _CLEAR))
            moves = tuple(
                Offer(command="move", title=title, arguments={"carrying": carrying}, why_not=busy)
                for title, carrying in (
                    ("The gripper is empty", False),
                    ("It carries something", True),
                )
            )
        return View(
            state="planned" if moves else "idle",
            text=text,
            columns=() if report is None else _COLUMNS,
            rows=() if report is None else tuple(_rows(report)),
            note=note,
            doing=doing,
            offers=(
                Offer(command="plan", title="Plan the motions", why_not=busy or no_file),
                *moves,
            ),
        )

    def _plan(self) -> dict[str, Any]:
        with self._alone():
            return self._planned(self._new(ARM_JOINTS))

    def _move(self, carrying: bool = False, check: bool = False) -> dict[str, Any]:
        """Move as outlined; ``carrying`` weighs what the hand carries, ``check`` keeps nothing."""
        with self._alone():
            return self._moved(carrying=carrying, check=check)

    def _identify(
        self,
        joints: tuple[str, ...] = (),
        carrying: bool = False,
        check: bool = False,
        outline: bool = False,
        undo: bool = False,
    ) -> dict[str, Any] | Started:
        joints = joints or ARM_JOINTS
        for joint in joints:
            if joint not in ARM_JOINTS:
                raise ConfigError("joints", joint, f"must be some of {', '.join(ARM_JOINTS)}")
        if carrying and set(joints) != set(ARM_JOINTS):
            raise ConfigError("joints", list(joints), "must be all to weigh what the hand carries")
        if undo:
            return self._undo()
        identification = self._new(joints)

        def run() -> dict[str, Any]:
            with self._alone():
                planned = self._planned(identification)
                if outline:
                    return planned
                del planned["duration_s"]
                return {**planned, **self._moved(carrying=carrying, check=check)}

        if outline:
            return run()
        done = own_thread(partial(copy_context().run, run))
        return Started(done, lambda _by: identification.cancel(), done.result)

    def _undo(self) -> dict[str, Any]:
        file = self._rig.settings.file
        if file is None:
            raise CalibrationError(
                None, "no calibration file is configured", 'set "calibration_file"'
            )
        kept = servo_file.restore(file)
        self._rig.reload()
        return {"at": kept.at, "file": str(servo_file.servos_path(file))}

    # How

    @contextmanager
    def _alone(self) -> Iterator[None]:
        if not self._one_at_a_time.acquire(blocking=False):
            raise MotionError("the arm is being identified already; wait for it, or stop the arm")
        try:
            yield
        finally:
            self._doing = ""
            self._one_at_a_time.release()

    def _new(self, joints: tuple[str, ...]) -> Identification:
        from so101_motion.setup.identify import Identification  # long to import

        return Identification(self._rig, joints)

    def _planned(self, identification: Identification) -> dict[str, Any]:
        search = Search(scene=self._ready())
        self.identification, self._outline = identification, None
        self._outline = outline = identification.outline(search)
        return {
            "will_move": outline.sentence,
            "cannot_move": dict(outline.obstacles),
            "duration_s": round(outline.duration, 1),
        }

    def _moved(self, *, carrying: bool, check: bool) -> dict[str, Any]:
        identification, outline = self.identification, self._outline
        if identification is None or outline is None:
            raise NotPossibleNow("move", "plan the motions first")
        self._outline = self.report = None
        self._show("Raising the arm")
        identification.move_and_record(
            outline, lambda joint, share: self._show(f"Moving {joint}, {share:.0%} done")
        )
        self._show("Computing the figures for half a minute")
        report = identification.report(hand_is_empty=not carrying, keeps=not check)
        if report.file is not None:
            self._rig.reload()
        self.report = report
        return report.to_json()

    def _show(self, doing: str) -> None:
        self._doing = doing
        self._on_progress(doing)


_COLUMNS = ("torque", "friction", "dead time", "play", "off, as sold", "as known")


def _rows(report: IdentifyReport) -> list[Row]:
    rows = []
    for joint, each in report.found.servos.items():
        told = report.predictions.get(joint)
        shares = (each.torque, each.friction, each.dead_time)
        angles = (each.play, *((told.as_sold, told.as_known) if told else (None, None)))
        cells = [f"{share:.0%}" for share in shares]
        cells += ["–" if angle is None else f"{to_deg(angle):.2f}°" for angle in angles]
        rows.append(Row(label=joint, cells=tuple(cells)))
    return rows
