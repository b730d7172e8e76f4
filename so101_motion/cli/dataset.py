"""``so101 dataset``: check LeRobot data sets and convert them."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from so101_motion.cli.param_types import IN_FILE, Finite, OutFile
from so101_motion.cli.shared import (
    CHECK_FAILED,
    F,
    Verbs,
    aside,
    json_option,
    print_json,
    write_report,
)
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_rad

if TYPE_CHECKING:
    from so101_motion.calib.record.store import Stored
    from so101_motion.tasks.datasets import CheckReport

_FOLDER = click.Path(path_type=Path, exists=True, file_okay=False)
_KINDS = click.Choice(["degrees", "range", "old", "model"])


@click.group(cls=Verbs)
def dataset() -> None:
    """Check data sets of LeRobot, and convert them."""


def _read_options(verb: F) -> F:
    """What all verbs want to know of a data set: its arm, its units and its calibration."""

    @click.option(
        "--arm",
        "side",
        type=click.Choice(["left", "right"]),
        default=None,
        help="Which arm, in a data set of two.",
    )
    @click.option("--units", type=_KINDS, help="What its numbers mean.  [default: found out]")
    @click.option(
        "--calibration", "calibration_file", type=IN_FILE,
        help="Calibration of the arm that was recorded: LeRobot's or ours.",
    )  # fmt: skip
    @functools.wraps(verb)
    def with_options(*args: Any, side: str | None, units: str | None, **kwargs: Any) -> Any:
        return verb(*args, side=side or "", units=units or "", **kwargs)

    return with_options  # type: ignore[return-value]  # its own options and those above


@dataset.command()
@click.argument("path", type=_FOLDER)
@_read_options
@click.option("--scene", "scene_file", type=IN_FILE, help="What was around the arm.")
@click.option(
    "--speed",
    type=Finite(1.0, 1000.0),
    default=180.0,
    show_default=True,
    metavar="DEG/S",
    help="From which joint speed on to say so.",
)
@click.option(
    "--worst", type=click.IntRange(0, 1000), default=10, show_default=True,
    help="How many moments to list.",
)  # fmt: skip
@click.option("--html", type=OutFile(".html"), help="Write a report with plots to this file.")
@json_option
def check(
    path: Path,
    side: str,
    units: str,
    calibration_file: Path | None,
    scene_file: Path | None,
    speed: float,
    worst: int,
    html: Path | None,
    as_json: bool,
) -> None:
    """Look for what makes the data set in PATH unfit to learn from or to replay.

    Jumps, limits, speeds, contact, joints that stand or are not where they were sent, time gaps,
    and numbers that mean something else than it seems. The worst moments come first.

    \b
    so101 dataset check ~/.cache/huggingface/lerobot/me/pick
    so101 dataset check pick --calibration arm.json --scene table.json --html report.html
    """  # noqa: D301
    from so101_motion.files.scene_file import read_scene
    from so101_motion.tasks.datasets import (
        Thresholds,
        check_data_set,
        html_report,
        open_data_set,
    )

    report = check_data_set(
        open_data_set(path, side=side),
        units=units,
        calibration=_calibration(calibration_file),
        scene=None if scene_file is None else read_scene(scene_file),
        thresholds=Thresholds(speed=to_rad(speed)),
    )
    if html is not None:
        write_report(html, html_report(report))
    if as_json:
        print_json("dataset-check", report.to_json())
    else:
        _print_check(report, worst)
    if report.moments:
        raise SystemExit(CHECK_FAILED)


@dataset.command()
@click.argument("path", type=_FOLDER)
@click.argument("out", type=click.Path(path_type=Path))
@_read_options
@click.option("--to", "to_units", type=_KINDS, help="What they shall mean.  [default: the same]")
@click.option(
    "--to-calibration",
    "to_calibration_file",
    type=IN_FILE,
    help="Calibration of the arm it shall fit.  [default: that of --calibration]",
)
@click.option("--link", is_flag=True, help="Link videos and images instead of copying them.")
@json_option
def convert(
    path: Path,
    out: Path,
    side: str,
    units: str,
    calibration_file: Path | None,
    to_units: str | None,
    to_calibration_file: Path | None,
    link: bool,
    as_json: bool,
) -> None:
    """Write the data set in PATH anew to OUT: other units, or an arm that is calibrated otherwise.

    The joints keep their angles, only the numbers that say them change. PATH is only read. OUT is
    there whole or not at all.

    \b
    so101 dataset convert old new --units old --to degrees --to-calibration arm.json
    so101 dataset convert mine yours --units range --calibration mine.json --to-calibration yours.json
    """  # noqa: D301, E501
    from so101_motion.tasks.datasets import convert_data_set, open_data_set
    from so101_motion.tasks.datasets.check import declared
    from so101_motion.tasks.datasets.units import exact_units_of

    data_set = open_data_set(path, side=side)
    units = units or declared(data_set)
    if not units:
        raise click.UsageError(
            "what do its numbers mean? --units says it; so101 dataset check finds out what fits"
        )
    calibration = _calibration(calibration_file)
    other = _calibration(to_calibration_file) or calibration
    source = exact_units_of(units, calibration, option="calibration")
    target = exact_units_of(to_units or units, other, option="to-calibration")
    for which, meant in (("recorded", source), ("new", target)):
        guessed = [j for j, by in zip(ARM_JOINTS, meant.zeros, strict=True) if by == "middle"]
        if guessed:
            aside(
                f"{which} arm: zero is taken to be the middle of the travel of {', '.join(guessed)}"
            )
    done = convert_data_set(data_set, out, source=source, target=target, link=link)
    beyond = {joint: count for joint, count in done.beyond.items() if count}
    if as_json:
        facts = {"from": units, "to": target.kind, "episodes": done.episodes, "frames": done.frames}
        print_json(
            "dataset-convert", {"path": str(path), "out": str(out), **facts, "beyond": beyond}
        )
        return
    for joint, count in beyond.items():
        click.echo(
            f"{joint} is beyond the new arm's travel in {count} frames; they were kept", err=True
        )
    click.echo(f"written to {out}: {done.episodes} episodes, {done.frames} frames", err=True)


def _calibration(file: Path | None) -> Stored | None:
    from so101_motion.calib.record import store

    if file is None:
        return None
    found = store.read(file.resolve())
    for note in found.notes:
        aside(note)
    return found


def _print_check(report: CheckReport, worst: int) -> None:
    from so101_motion.tasks.datasets.moments import KINDS
    from so101_motion.tasks.datasets.units import IN_WORDS

    metadata = report.data_set.metadata
    minutes = report.frames / metadata.fps / 60.0
    click.echo(
        f"{metadata.root}: LeRobot {metadata.version}, {metadata.robot or 'no robot named'},"
        f" {report.episodes} episodes, {report.frames} frames at {metadata.fps:g} a second"
        f" ({minutes:.1f} min)"
    )
    click.echo(f"units: {IN_WORDS[report.units.kind]}; {report.why_units}")
    off = report.differences
    if off is None:
        click.echo("where the joints were is not recorded")
    else:
        click.echo(
            f"joints are {1000.0 * off.lag_s:.0f} ms late; with that taken out, off by [deg]"
        )
        click.echo(f"  {'':<14}{'rms':>8}{'mean':>8}{'worst':>8}")
        for joint, rms in off.rms_deg.items():
            mean, worst_deg = off.mean_deg[joint], off.worst_deg[joint]
            click.echo(f"  {joint:<14}{rms:8.2f}{mean:8.2f}{worst_deg:8.2f}")
    for note in report.notes:
        click.echo(f"note: {note}")
    if not report.moments:
        click.echo("nothing wrong was found")
        return
    click.echo("")
    for kind, words in KINDS.items():
        if report.counts.get(kind):
            seconds = report.frames_of.get(kind, 0) / metadata.fps
            click.echo(f"{report.counts[kind]:7} x {kind:<12} {seconds:8.1f} s  {words}")
    if worst:
        click.echo("\nthe worst moments:")
    for moment in report.moments[:worst]:
        click.echo(f"  episode {moment.episode:>4}, {moment.t:7.2f} s  {moment.sentence}")
