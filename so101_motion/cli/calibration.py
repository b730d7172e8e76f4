"""``so101 calibration …``: what there is to do with calibration files and the servos' own."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from so101_motion.cli import port_choice
from so101_motion.cli.completion import completed_files
from so101_motion.cli.options import DRY_RUN, JSON, argument, flag, option, verb
from so101_motion.cli.param_types import IN_FILE, port_option
from so101_motion.cli.shared import (
    CHECK_FAILED,
    STOPPED,
    Verbs,
    answer,
    aside,
    echo,
    print_json,
    quietly,
)
from so101_motion.common.errors import CalibrationError, OtherCalibration
from so101_motion.common.units import to_deg

if TYPE_CHECKING:
    from so101_motion.calib.procedure.verification import JointComparison
    from so101_motion.calib.record.compare import Difference
    from so101_motion.calib.record.record import Calibration, HeldCalibration
    from so101_motion.calib.record.store import Stored
    from so101_motion.setup.discovery import PortReport


_FILE = argument(shell_complete=completed_files)
_PORT = port_option("Serial port of the arm; by default the only one with an arm")


@click.group(cls=Verbs)
def calibration() -> None:
    """Show, compare, verify, import, export, restore and write calibration files."""


@verb(calibration)
def show(
    file: str | None = argument(required=False, shell_complete=completed_files),
    as_json: bool = JSON,
) -> None:
    """Show the content of a calibration file; without FILE, list the files.

    Also shown are the source of each joint's zero, the error at the jaws that it may cause [mm],
    and the earlier versions.
    """
    if file is None:
        _list_files(as_json)
        return
    from so101_motion.calib.record import store
    from so101_motion.calib.record.zero_report import explain_stored

    stored = store.read(store.resolve(file))
    kept = store.versions(stored.path)
    explained = explain_stored(stored)
    if as_json:
        meaning = [
            {"joint": m.joint, "by": m.by, "jaws_mm": m.jaws_mm, "sentence": m.sentence}
            for m in explained
        ]
        dated = [{"number": each.number, "kept_at": each.kept_at.isoformat()} for each in kept]
        print_json("calibration", {**facts(stored), "meaning": meaning, "versions": dated})
        return
    click.echo(str(stored.path))
    _table(stored.calibration)
    for each in explained:
        echo(each.sentence, indent="  ")
    for version in kept:
        click.echo(f"  version {version.number}, kept {version.kept_at:%Y-%m-%d %H:%M} UTC")
    _notes(stored)


@verb(calibration)
def diff(
    file: str = _FILE,
    other: str | None = argument(required=False, shell_complete=completed_files),
    port: str | None = _PORT,
    as_json: bool = JSON,
) -> None:
    """Compare FILE with the servos' registers, or with the file OTHER.

    Exit code 6 if they differ.
    """
    from so101_motion.calib.record import compare, store

    stored = store.read(store.resolve(file))
    calibration = stored.calibration
    _notes(stored)
    there: Mapping[str, HeldCalibration]
    if other is not None:
        there = store.read(store.resolve(other)).calibration
    else:
        there = _read_registers(port)
    rows = compare.diff(calibration, there)
    missing = [joint for joint in calibration if joint not in there]
    if as_json:
        print_json("calibration-diff", {"rows": list(map(asdict, rows)), "missing": missing})
    else:
        _print_diff(rows, missing, "the servos" if other is None else other)
    if missing or stored.refused or any(row.differs for row in rows):
        raise SystemExit(CHECK_FAILED)


@verb(calibration)
def export(
    file: str = _FILE,
    lerobot: str | None = option(
        "Save it where LeRobot looks for the arm with this --robot.id.", metavar="ID"
    ),
    kind: str = option(
        "With --lerobot: its kind of arm, such as so_leader.", default="", show_default=False
    ),
    out: Path | None = option("Write to this file.", click.Path(path_type=Path)),
) -> None:
    """Print FILE in LeRobot's format, or save it with --lerobot or --out.

    \b
    so101 calibration export my_arm.json --lerobot my_follower
    """  # noqa: D301
    from so101_motion.calib.record import lerobot as format_of_lerobot
    from so101_motion.calib.record import store

    if lerobot is not None and out is not None:
        raise click.UsageError("give either --lerobot or --out")
    stored = store.read(store.resolve(file))
    calibration = stored.calibration
    _notes(stored)
    path = out if lerobot is None else format_of_lerobot.path_for(lerobot, kind=kind)
    if path is None:
        click.echo(format_of_lerobot.text(calibration).decode(), nl=False)
        return
    format_of_lerobot.export(calibration, path)
    click.echo(f"written to {path}")
    aside("LeRobot's zero is the middle of each travel, so the zeros of this file are not written")


@verb(calibration, "import")
def import_(
    source: str = _FILE,
    file: str | None = option(
        "Where to save it; by default in your data directory, same name.",
        shell_complete=completed_files,
    ),
    joint_zero: str | None = option(
        "Where zero is: the middle of the travel, or the pose of set_homing in a Viam machine.",
        click.Choice(["middle", "homing"]),
    ),
    dry_run: bool = DRY_RUN,
    as_json: bool = JSON,
) -> None:
    """Import a calibration of LeRobot or of the published module.

    If there is such a file already, its content is kept as a version. "so101 calibration write"
    stores the numbers in the servos.

    \b
    so101 calibration import ~/.cache/huggingface/lerobot/calibration/robots/so_follower/me.json
    """  # noqa: D301
    from so101_motion.calib.record import store
    from so101_motion.calib.record.zero import by_convention
    from so101_motion.common.state import GRIPPER_JOINT
    from so101_motion.files import user_storage

    read = store.read(store.resolve(source))
    if joint_zero is not None:
        chosen = {
            joint: by_convention(entry, joint_zero)
            for joint, entry in read.calibration.items()
            if joint != GRIPPER_JOINT
        }
        read = replace(read, zeros={**chosen, **read.zeros}, zero_note="")
    path = user_storage.folder() / read.path.name if file is None else store.resolve(file)
    if dry_run:
        _print_dry_run(replace(read, path=path), as_json)
        return
    stored = store.save(path, read.calibration, zeros=read.zeros)
    told = replace(stored, notes=(*_told(read), *stored.notes), zero_note="")
    _print(told, f"saved to {stored.path}", as_json)
    if as_json:
        return
    aside(f"next: so101 calibration show {stored.path}")


@verb(calibration)
def restore(
    file: str = _FILE,
    number: int | None = option(
        "Which version; by default the newest that differs.", int, metavar="N"
    ),
    port: str | None = port_option("Store it in the servos on this port as well"),
    yes: bool = flag("With --port: store without asking."),
    dry_run: bool = DRY_RUN,
    as_json: bool = JSON,
) -> None:
    """Restore the previous version of FILE; the present one is kept as a version.

    At a terminal you are asked whether to store it in the servos as well, if an arm has FILE.
    "so101 calibration show FILE" lists the versions.
    """
    from so101_motion.calib.record import store

    path = store.resolve(file)
    if dry_run:
        _print_dry_run(replace(store.earlier(path, number), path=path), as_json)
        return
    is_manned = sys.stdin is not None and sys.stdin.isatty()
    if port is not None and not (yes or is_manned):
        raise click.UsageError("there is nobody to ask; give --yes to store it in the servos")
    if port is not None:
        report: PortReport | None = port_choice.look_at(port)
    else:
        report = _arm_with(path) if is_manned and not as_json else None
    stored = store.restore(path, number)
    _print(stored, f"{stored.path} is restored:", as_json)
    if report is not None and (
        yes or click.confirm(f"Store it in the servos on {report.port.name} too?", err=True)
    ):
        _write(stored, report)
        return
    aside(f"the servos are as before; to store it in them: so101 calibration write {stored.path}")


def _arm_with(path: Path) -> PortReport | None:
    """The only arm whose servos hold the calibration in this file; None without one."""
    from so101_motion.setup.discovery import discover

    found = [report for report in discover().reports if report.calibration == path]
    return found[0] if len(found) == 1 else None


@verb(calibration)
def write(
    file: str = _FILE, port: str | None = _PORT, yes: bool = flag("Write without asking.")
) -> None:
    """Store FILE in the servos; what they held is kept as a version of FILE.

    Use it if the arm is refused because its servos hold another calibration, and FILE is right.
    Held joints stay held where they are; one that is outside its new range goes limp.
    """
    from so101_motion.calib.record import store

    stored = store.read(store.resolve(file))
    report = port_choice.find_to_examine(port)
    if not yes:
        _agree(f"Store {stored.path} in the servos on {report.port.name}? {_GO_LIMP}")
    _write(stored, report)


@verb(calibration)
def verify(
    file: str | None = argument(required=False, shell_complete=completed_files),
    port: str | None = _PORT,
    yes: bool = flag("Ask no questions; it ends after two minutes."),
    as_json: bool = JSON,
) -> None:
    """Check a calibration: you lead the limp joints to their stops by hand.

    It tells how far the stops are from those of FILE, in degrees, and takes two minutes. Nothing is
    written. Without FILE it is the file that this arm has. Exit code 6 if they differ. wrist_roll
    has no stops, so it is not checked.
    """
    path, rows = verified(file, port, yes)
    content = {"file": str(path), "joints": list(map(asdict, rows))}
    told = "\n".join(f"{row.joint}: {row.sentence}" for row in rows)
    answer(as_json, "calibration-verify", content, told)
    if not all(row.agrees for row in rows):
        raise SystemExit(CHECK_FAILED)


@verb(calibration)
def accept(
    file: Path = argument(IN_FILE),
    name: str = option(
        "Only this pose of poses, or arm of a cell's program.", default="", show_default=False
    ),
) -> None:
    """Use the angles in FILE as they are, with whatever calibration an arm has.

    FILE has poses, a program or a guided path, and was made with another calibration. Its angles
    stay; the encoder positions of the joints' zeros, which tell that calibration, are removed.
    """
    from so101_motion.files import user_storage

    removed = user_storage.without_zeros(file, name)
    if not removed:
        raise click.UsageError(
            f"{file} has no calibration{f' of {name}' if name else ''} to remove"
        )
    click.echo(f"{file}: {removed} calibration(s) removed; its angles are used as they are")


# Also used by other verbs


def ask_and_write(other: OtherCalibration, port: str) -> None:
    from so101_motion.calib.record import store

    aside(str(other))
    _agree(f"Store it in the servos now? What they hold is kept. {_GO_LIMP}")
    _write(store.read(other.file), port_choice.look_at(port))


_GO_LIMP = "A held joint that is outside its new range goes limp: support the arm."


def _agree(question: str) -> None:
    try:
        agreed = click.confirm(question, err=True)
    except click.Abort:
        raise click.UsageError("there is no answer; give --yes to write without asking") from None
    if not agreed:
        aside("nothing was written")
        raise SystemExit(STOPPED)


def _write(stored: Stored, report: PortReport) -> None:
    from so101_motion.calib.procedure.eeprom import write_calibration

    with port_choice.lent_bus(report, "writing a calibration") as (_, lease):
        kept = lease.call(lambda bus: write_calibration(bus, stored))
    aside(f"the servos on {report.port.name} hold {stored.path}")
    if kept is not None:
        undo = f"so101 calibration write {kept} --port {report.port.name}"
        aside(f"what they held before is kept; to put it back: {undo}")


def facts(stored: Stored) -> dict[str, Any]:
    return {
        "file": str(stored.path),
        "calibration": {joint: entry.to_json() for joint, entry in stored.calibration.items()},
        "zeros": {
            joint: {"by": zero.by, "middle_deg": round(to_deg(zero.angle), 3)}
            for joint, zero in stored.zeros.items()
        },
        "notes": _told(stored),
    }


def _told(stored: Stored) -> list[str]:
    return [*stored.notes, stored.zero_note] if stored.zero_note else list(stored.notes)


def verified(
    file: str | None, port: str | None, yes: bool
) -> tuple[Path, tuple[JointComparison, ...]]:
    """Have the joints led to their stops; the calibration file and the comparison of each joint."""
    from so101_motion.calib.procedure.verification import Verification
    from so101_motion.calib.record import store
    from so101_motion.cli.operation_terminal import OperationTerminal
    from so101_motion.cli.terminal import Quit, Terminal

    report = port_choice.find_arm(port)
    stored = store.read(port_choice.calibration_file(file, report))
    with (
        quietly(),
        port_choice.lent_bus(report, "verifying a calibration") as (_, lease),
        Terminal(ask=not yes) as terminal,
    ):
        terminal.say(f"arm on {report.port.name}; {stored.path} is verified")
        is_attended = terminal.is_manned
        verification = Verification(stored.calibration, lease, is_attended=is_attended)
        try:
            OperationTerminal(verification, terminal).go()
        except Quit:
            raise SystemExit(STOPPED) from None
        terminal.say("the joints stay limp")
        return stored.path, verification.joints


# Output and reading


def _list_files(as_json: bool) -> None:
    from so101_motion.calib.record import file_search

    found = file_search.find()
    if as_json:
        explained = [
            {
                "file": str(one.path),
                "origin": one.origin,
                "role": one.role,
                "joints": list(one.stored.calibration) if one.stored is not None else [],
                "problem": one.problem,
            }
            for one in found
        ]
        print_json("calibrations", {"files": explained})
        return
    for one in found:
        joints = len(one.stored.calibration) if one.stored is not None else 0
        role = "" if one.role == "unknown" else f" of a {one.role}"
        click.echo(str(one.path))
        echo(one.problem or f"{one.origin}{role}, {joints} joints", indent="  ")
    if not found:
        aside("no calibration file was found; so101 calibrate makes one")


def _print(stored: Stored, heading: str, as_json: bool, **more: object) -> None:
    if as_json:
        print_json("calibration", {**facts(stored), **more})
        return
    click.echo(heading)
    _table(stored.calibration)
    _notes(stored)


def _table(calibration: Calibration) -> None:
    click.echo(f"  {'joint':<15}{'id':>3}{'offset':>8}{'from':>7}{'to':>7}{'travel':>10}")
    for joint, entry in calibration.items():
        travel_deg = (entry.range_max - entry.range_min) * 360.0 / 4096.0
        click.echo(
            f"  {joint:<15}{entry.id:>3}{entry.homing_offset:>8}{entry.range_min:>7}"
            f"{entry.range_max:>7}{travel_deg:>6.0f} deg"
        )


def _print_dry_run(wanted: Stored, as_json: bool) -> None:
    from so101_motion.calib.record import compare, store

    try:
        now = store.read(wanted.path).calibration
    except CalibrationError:
        now = {}  # no file, or one that cannot be used and would be kept as a version
    rows = compare.diff(wanted.calibration, now, tolerance=0)
    changes = [
        {"joint": row.joint, "field": row.field, "now": row.held, "then": row.filed}
        for row in rows
        if row.differs or row.held is None
    ]
    heading = f"this would be saved to {wanted.path}:"
    _print(wanted, heading, as_json, dry_run=True, changes=changes)
    if as_json:
        return
    for row in rows:
        if row.differs:
            aside(f"  {row.joint}: {row.field} {row.held} -> {row.filed}")
    if not now:
        aside("there is no usable file yet")
    elif not any(row.differs for row in rows):
        aside("the file is the same now")
    aside("nothing was written")


def _notes(stored: Stored) -> None:
    for note in _told(stored):
        echo(f"note: {note}", err=True)


def _print_diff(rows: tuple[Difference, ...], missing: list[str], there: str) -> None:
    different = [row for row in rows if row.differs]
    for row in different:
        click.echo(f"{row.joint}: {row.field} is {row.filed} in the file, {row.held} in {there}")
    for joint in missing:
        click.echo(f"{joint}: missing in {there}")
    if not different and not missing:
        click.echo(f"the same as in {there}")


def _read_registers(port: str | None) -> Mapping[str, HeldCalibration]:
    from so101_motion.calib.motors.arm_identification import look

    report = port_choice.find_arm(port)
    with quietly(), port_choice.lent_bus(report, "a comparison") as (_, lease):
        return lease.call(look).held
