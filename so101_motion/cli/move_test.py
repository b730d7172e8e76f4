"""``so101 move-test``: does the arm do what it is told? Small slow motions, measured."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING

import click

from so101_motion import __version__
from so101_motion.cli.shared import (
    CHECK_FAILED,
    have_agreed,
    json_option,
    print_json,
    quietly,
    reports_errors,
    write_report,
)
from so101_motion.cli.sources import Source, source_options

if TYPE_CHECKING:
    from so101_motion.accuracy import MoveReport
    from so101_motion.move_test import MoveTest, Outline, Progress


@click.command("move-test")
@source_options
@click.option("--yes", is_flag=True, help="Move without asking.")
@click.option(
    "--report", type=click.Path(path_type=Path), help="Write the result to this JSON file."
)
@json_option
@reports_errors
def move_test(source: Source, yes: bool, report: Path | None, as_json: bool) -> None:
    """Move every joint a little and see whether it does as it is told. The arm MOVES.

    One joint after the other goes six degrees to and fro, slowly, clear of everything that is
    known, and stands still to be measured; at last the jaw opens and closes a little. Ctrl-C stops
    the arm. Exit code 6 if a joint does not obey.

    \b
    so101 move-test --port /dev/ttyACM0 --report test.json
    so101 move-test --sim --yes
    """  # noqa: D301
    from so101_motion.move_test import MoveTest

    with quietly(), source.open() as rig:
        test = MoveTest(arm=rig.arm, gripper=rig.gripper, clock=rig.clock, name=source.what)
        outline = test.outline()
        for joint, reason in outline.obstacles:
            click.echo(f"{joint} cannot be tested here: {reason}", err=True)
        click.echo(outline.sentence, err=True)
        if not yes:
            have_agreed(f"Is everything out of the way? Move the {source.what}?")
        found = _tested(test, outline)
    if as_json:
        print_json("move-test", found.to_json())
    else:
        click.echo(found.text(), nl=False)
    if report is not None:
        write_report(report, found.file({"version": __version__}))
    if not found.passed:
        raise SystemExit(CHECK_FAILED)


def _tested(test: MoveTest, outline: Outline) -> MoveReport:
    """Run the test beside this thread, which Ctrl-C reaches."""
    found: list[MoveReport] = []
    troubles: list[BaseException] = []

    def run() -> None:
        try:
            found.append(test.move_and_measure(outline, _tell))
        except BaseException as error:  # raised again where it is waited for
            troubles.append(error)

    thread = threading.Thread(target=run, name="so101-move-test")
    thread.start()
    while thread.is_alive():
        try:
            thread.join(0.1)
        except KeyboardInterrupt:
            test.cancel()
    if troubles:
        raise troubles[0]
    return found[0]


def _tell(progress: Progress) -> None:
    if progress.joint:
        click.echo(f"{100.0 * progress.share:3.0f} %  {progress.joint}", err=True)
