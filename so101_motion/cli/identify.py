"""``so101 identify``: measure how this arm's servos differ, and the load in its hand. It MOVES."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from so101_motion.cli.options import JSON, YES, flag, option, verb
from so101_motion.cli.shared import have_agreed, print_json, quietly, run_beside
from so101_motion.cli.sources import SOURCE, Source


@verb()
def identify(
    source: Source = SOURCE,
    carrying: bool = flag("The hand holds something: measure its weight as well."),
    check: bool = flag("Keep nothing; only say how well the figures predict."),
    record: Path | None = option(
        "Write goals, positions and voltages of each joint there; no serial number.",
        click.Path(path_type=Path, file_okay=False),
        metavar="FOLDER",
    ),
    undo: bool = flag("Move nothing: restore the previous figures."),
    yes: bool = YES,
    as_json: bool = JSON,
) -> None:
    """Measure how this arm's servos differ from their type. The arm MOVES.

    The arm is raised, and one joint after the other moves back and forth through a wide part of its
    range, clear of all known obstacles, for nearly three minutes. The hand must be empty;
    otherwise give --carrying. The result is saved beside the calibration, and used from the next
    start on. Ctrl-C stops the arm.

    \b
    so101 identify --port /dev/ttyACM0
    so101 identify --port /dev/ttyACM0 --carrying
    so101 identify --port /dev/ttyACM0 --check
    so101 identify --port /dev/ttyACM0 --undo
    """  # noqa: D301
    from so101_motion.rig.hardware_rig import HardwareRig
    from so101_motion.setup.identify_operation import IdentifyOperation

    if undo:
        _restore_figures(source, as_json)
        return
    with quietly(), source.open() as rig:
        if not isinstance(rig, HardwareRig):
            raise click.UsageError("the simulated arm has no servos to identify; give --port")
        operation = IdentifyOperation(rig, on_progress=partial(click.echo, err=True))
        planned = operation.ask("plan")
        for joint, reason in planned["cannot_move"].items():
            click.echo(f"{joint} cannot be identified here: {reason}", err=True)
        click.echo(planned["will_move"], err=True)
        if not yes:
            have_agreed(f"Is everything out of the way? Move the {source.what}?")
        move = partial(operation.ask, "move", carrying=carrying, check=check)
        run_beside(move, operation.close)
        report, identification = operation.report, operation.identification
        assert report is not None
        assert identification is not None
        if record is not None:
            files = identification.write_recordings(record, hand_is_empty=not carrying)
            click.echo(f"{len(files)} recordings in {record}; they stay on this computer", err=True)
    if as_json:
        print_json("identify", report.to_json())
    else:
        click.echo(report.text(), nl=False)


def _restore_figures(source: Source, as_json: bool) -> None:
    """Restore the figures that the last identification replaced."""
    from so101_motion.calib.record import servo_file
    from so101_motion.common.errors import CalibrationError

    calibration = source.known_calibration()
    if calibration is None:
        raise CalibrationError(None, f"the {source.what} has no calibration", "calibrate it first")
    kept = servo_file.restore(calibration)
    file = servo_file.servos_path(calibration)
    if as_json:
        print_json("identify", {"file": str(file), "at": kept.at, "joints": list(kept.servos)})
    else:
        click.echo(f"{file} has the figures of {kept.at} again; they are used from the next start")
