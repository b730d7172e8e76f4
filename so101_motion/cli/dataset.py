"""``so101 dataset``: check, convert and replay LeRobot data sets."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from so101_motion.cli.options import JSON, YES, argument, flag, option, verb
from so101_motion.cli.param_types import IN_FILE, SCENE, Finite, OutFile
from so101_motion.cli.shared import (
    CHECK_FAILED,
    Verbs,
    aside,
    print_json,
    quietly,
    stops_on_ctrl_c,
    write_report,
)
from so101_motion.cli.sources import SOURCE, Source, ending, paced
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_rad

if TYPE_CHECKING:
    from so101_motion.calib.record.store import Stored
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.tasks.datasets import CheckReport, DataSet
    from so101_motion.tasks.datasets.joint_checks import Differences

_FOLDER = click.Path(path_type=Path, exists=True, file_okay=False)
_SPEED_DEG, _ACCELERATION_DEG = 180.0, 500.0  # caps of a replay, as of teleoperation
_KINDS = click.Choice(["degrees", "range", "old", "model"])


@click.group(cls=Verbs)
def dataset() -> None:
    """Check, convert and replay data sets of LeRobot."""


_PATH = argument(_FOLDER)
_SIDE = option("Which arm, in a data set of two.", click.Choice(["left", "right"]), name="--arm")
_UNITS = option("Units of its numbers.", _KINDS)
_RECORDED = option(
    "Calibration of the arm that was recorded: LeRobot's or ours.", IN_FILE, name="--calibration"
)


@verb(dataset)
def check(
    path: Path = _PATH,
    side: str | None = _SIDE,
    units: str | None = _UNITS,
    calibration_file: Path | None = _RECORDED,
    scene: Scene | None = SCENE,
    speed: float = option(
        "Report joint speeds above this.", Finite(1.0, 1000.0), 180.0, metavar="DEG/S"
    ),
    worst: int = option("Number of moments to list.", click.IntRange(0, 1000), 10),
    html: Path | None = option("Write a report with plots to this file.", OutFile(".html")),
    as_json: bool = JSON,
) -> None:
    """Check whether the data set in PATH is fit for training and for replay.

    Finds jumps, exceeded limits and speeds, contact, joints that stand still or do not reach their
    commands, time gaps, and numbers in other units than declared. The worst moments come first.

    \b
    so101 dataset check ~/.cache/huggingface/lerobot/me/pick
    so101 dataset check pick --calibration arm.json --scene table.json --html report.html
    """  # noqa: D301
    from so101_motion.tasks.datasets import check_data_set, html_report, open_data_set

    data_set = open_data_set(path, side=side or "")
    report = check_data_set(
        data_set,
        units=units or "",
        calibration=read_calibration(calibration_file) or data_set.calibration,
        scene=scene,
        speed=to_rad(speed),
    )
    if html is not None:
        write_report(html, html_report(report))
    if as_json:
        print_json("dataset-check", report.to_json())
    else:
        _print_check(report, worst)
    if report.moments:
        raise SystemExit(CHECK_FAILED)


@verb(dataset)
def convert(
    path: Path = _PATH,
    out: Path = argument(click.Path(path_type=Path)),
    side: str | None = _SIDE,
    units: str | None = _UNITS,
    calibration_file: Path | None = _RECORDED,
    to: str | None = option("Units to convert to.  [default: the same]", _KINDS),
    to_calibration: Path | None = option(
        "Calibration of the arm that will use it.  [default: that of --calibration]", IN_FILE
    ),
    link: bool = flag("Link videos and images instead of copying them."),
    as_json: bool = JSON,
) -> None:
    """Copy the data set in PATH to OUT, in other units or for another calibration.

    The joint angles stay the same, only their numbers change. PATH is only read. If the conversion
    fails, OUT is not made.

    \b
    so101 dataset convert old new --units old --to degrees --to-calibration arm.json
    so101 dataset convert mine yours --units range --calibration mine.json --to-calibration yours.json
    """  # noqa: D301, E501
    from so101_motion.tasks.datasets import convert_data_set, open_data_set
    from so101_motion.tasks.datasets.units import exact_units_of

    data_set = open_data_set(path, side=side or "")
    units = _units_kind(data_set, units)
    calibration = read_calibration(calibration_file) or data_set.calibration
    other = read_calibration(to_calibration) or calibration
    source = exact_units_of(units, calibration, option="calibration")
    target = exact_units_of(to or units, other, option="to-calibration")
    for which, meant in (("recorded", source), ("new", target)):
        guessed = [j for j, by in zip(ARM_JOINTS, meant.zeros, strict=True) if by == "middle"]
        if guessed:
            aside(f"{which} arm: the middle of the travel is used as zero of {', '.join(guessed)}")
    done = convert_data_set(data_set, out, source=source, target=target, link=link)
    beyond = {joint: count for joint, count in done.beyond.items() if count}
    if as_json:
        facts = {"from": units, "to": target.kind, "episodes": done.episodes, "frames": done.frames}
        facts |= {"path": str(path), "out": str(out), "beyond": beyond}
        print_json("dataset-convert", facts)
        return
    for joint, count in beyond.items():
        aside(f"{joint} is beyond the new arm's travel in {count} frames; they were kept")
    episodes = f"{done.episodes} episode{'s' * (done.episodes != 1)}"
    aside(f"written to {out}: {episodes}, {done.frames} frames")


@verb(dataset)
def replay(
    path: Path = _PATH,
    episode: int = option("Which one.", click.IntRange(0), required=True),
    source: Source = ending(paced(SOURCE)),
    side: str | None = _SIDE,
    units: str | None = _UNITS,
    recorded_with: Path | None = option(
        "Calibration of the arm that was recorded.  [default: that of this arm]", IN_FILE
    ),
    state: bool = flag("Follow the measured positions, not the commands."),
    start: float = option("Start at this time [s].", Finite(0.0), 0.0, metavar="S"),
    scene: Scene | None = SCENE,
    yes: bool = YES,
    as_json: bool = JSON,
) -> None:
    """Replay an episode of the data set in PATH, and print how closely the arm followed.

    The arm moves to the first frame along a plan and then follows the recording at its own speed,
    within its caps (180 deg/s and 500 deg/s^2 by default) and clear of itself, the table and the
    scene. Ctrl-C stops it.

    \b
    so101 dataset replay pick --episode 3 --sim --units degrees
    so101 dataset replay pick --episode 3 --port /dev/ttyACM0 --units range --speed 90
    """  # noqa: D301
    from so101_motion.tasks.datasets import open_data_set, units_of
    from so101_motion.tasks.datasets.replay import calibration_of, plan_episode, replay_episode

    data_set = open_data_set(path, side=side or "")
    kind = _units_kind(data_set, units)
    recorded = read_calibration(recorded_with) or data_set.calibration
    if source.speed is None:
        source = replace(source, speed=to_rad(_SPEED_DEG))
    if source.acceleration is None:
        source = replace(source, acceleration=to_rad(_ACCELERATION_DEG))
    with quietly(), source.open() as rig:
        if scene is not None:
            rig.arm.scene = scene
        meant = units_of(kind, recorded or calibration_of(rig))
        planned = plan_episode(
            rig, data_set, episode, units=meant, of="state" if state else "action", start=start
        )
        if not as_json:
            aside(
                f"{planned.approach.duration:.1f} s to the first frame, then"
                f" {planned.duration:.1f} s as recorded"
            )
            declared_fps = data_set.metadata.fps
            if abs(planned.fps / declared_fps - 1.0) > 0.02:
                aside(
                    f"the time stamps give {planned.fps:.3g} frames a second, info.json"
                    f" {declared_fps:g}; the arm follows the time stamps"
                )
            for doubt in planned.doubts:
                aside(doubt)
            for joint, count in planned.beyond.items():
                aside(
                    f"{joint} is beyond this arm's range in {count} frames; it waits at its limit"
                )
        source.have_agreed(rig, f"Move the {source.what}?", yes)
        with stops_on_ctrl_c(rig.arm):
            outcome = replay_episode(rig, planned)
    if as_json:
        facts = {"path": str(path), "episode": episode, "duration_s": planned.duration}
        print_json("dataset-replay", {**facts, "beyond": planned.beyond, **asdict(outcome)})
    else:
        _print_differences(outcome.differences)
        if outcome.held_by:
            click.echo(f"held back for {outcome.held_s:.1f} s: {', '.join(outcome.held_by)}")
    if outcome.held_by:
        raise SystemExit(CHECK_FAILED)


def _units_kind(data_set: DataSet, units: str | None) -> str:
    """The units given by option or declared in the data set; refuses if there are none."""
    kind = units or data_set.declared
    if not kind:
        raise click.UsageError(
            "the units of its numbers are unknown; give --units (so101 dataset check finds out"
            " which fit)"
        )
    return kind


def read_calibration(file: Path | None) -> Stored | None:
    """Read a calibration file and print its notes; None for no file."""
    from so101_motion.calib.record import store

    if file is None:
        return None
    found = store.read(file.resolve())
    for note in found.notes:
        aside(note)
    return found


def _print_check(report: CheckReport, worst: int) -> None:
    from so101_motion.tasks.datasets.moments import KINDS

    metadata, (what, units) = report.data_set.metadata, report.headlines
    click.echo(f"{metadata.root}: {what}\n{units}")
    if report.differences is None:
        click.echo("the joints' measured positions were not recorded, only the commands")
    else:
        _print_differences(report.differences)
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


def _print_differences(off: Differences) -> None:
    click.echo(f"joints lag by {1000.0 * off.lag_s:.0f} ms; errors without that lag [deg]")
    click.echo(f"  {'':<14}{'rms':>8}{'mean':>8}{'worst':>8}")
    for joint, rms in off.rms_deg.items():
        click.echo(f"  {joint:<14}{rms:8.2f}{off.mean_deg[joint]:8.2f}{off.worst_deg[joint]:8.2f}")
