"""``so101 move-test``: move every joint a little, and check that it follows."""

from __future__ import annotations

import threading
from functools import partial
from pathlib import Path

import click

from so101_motion import __version__
from so101_motion.cli.options import JSON, YES, option, verb
from so101_motion.cli.param_types import OutFile
from so101_motion.cli.shared import (
    CHECK_FAILED,
    INTERRUPTED,
    have_agreed,
    print_json,
    quietly,
    run_beside,
    write_report,
)
from so101_motion.cli.sources import SOURCE, Source


@verb()
def move_test(
    source: Source = SOURCE,
    yes: bool = YES,
    report: Path | None = option("Write the result to this JSON file.", OutFile()),
    as_json: bool = JSON,
) -> None:
    """Move every joint a little and check that it follows commands. The arm MOVES.

    One joint after the other moves six degrees back and forth, slowly, clear of all known
    obstacles, and stands still to be measured; then the jaw opens and closes a little. Ctrl-C stops
    the arm. Exit code 6 if a joint does not follow.

    \b
    so101 move-test --port /dev/ttyACM0 --report test.json
    so101 move-test --sim --yes
    """  # noqa: D301
    from so101_motion.setup.move_test import MoveTest

    stopped = threading.Event()
    with quietly(), source.open() as rig:
        test = MoveTest(rig, name=source.what)
        outline = test.outline()
        for reason in dict.fromkeys(reason for _, reason in outline.obstacles):
            joints = ", ".join(joint for joint, each in outline.obstacles if each == reason)
            click.echo(f"cannot be tested here: {joints}: {reason}", err=True)
        click.echo(outline.sentence, err=True)
        if not yes:
            have_agreed(f"Is everything out of the way? Move the {source.what}?")

        def stop() -> None:
            stopped.set()
            test.cancel()

        move = partial(test.move_and_measure, outline, _print_progress)
        found = run_beside(move, stop)
    if as_json:
        print_json("move-test", found.to_json())
    else:
        click.echo(found.text(), nl=False)
    if report is not None:
        write_report(report, found.file({"version": __version__}))
    if stopped.is_set():
        raise SystemExit(INTERRUPTED)
    if not found.passed:
        raise SystemExit(CHECK_FAILED)


def _print_progress(joint: str, share: float) -> None:
    click.echo(f"{100.0 * share:3.0f} %  {joint}", err=True)
