"""``so101 plan`` and ``so101 move``: a goal on the command line, planned, and for ``move`` run."""

from __future__ import annotations

import contextlib
import functools
import sys
import threading
from collections.abc import Callable
from concurrent.futures import TimeoutError as NotYet
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
import numpy as np

from so101_motion.cli.shared import (
    have_agreed,
    import_preview,
    json_option,
    patience,
    print_json,
    quietly,
    reports_errors,
)
from so101_motion.cli.sources import AnySource, Source, any_source_options, paced
from so101_motion.cli.tables import plan_table
from so101_motion.named_poses import POSES
from so101_motion.state import ARM_JOINTS
from so101_motion.units import to_deg, to_m, to_mm, to_rad

if TYPE_CHECKING:
    from so101_motion.geometry import Array
    from so101_motion.motion import Motion
    from so101_motion.planning.goals import Goal
    from so101_motion.planning.plan import Plan
    from so101_motion.rig_like import RigLike

F = TypeVar("F", bound=Callable[..., Any])


class _Numbers(click.ParamType[np.ndarray]):
    """So many numbers with commas between."""

    def __init__(self, *names: str) -> None:
        self.name = ",".join(names)
        self._count = len(names)

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> np.ndarray:
        try:
            numbers = np.array([float(part) for part in str(value).split(",")])
        except ValueError:
            self.fail(f"{value!r} is not a list of numbers such as {self.name}", param, ctx)
        if len(numbers) != self._count or not np.all(np.isfinite(numbers)):
            self.fail(f"{value!r} must be {self._count} numbers: {self.name}", param, ctx)
        return numbers


_POINT = _Numbers("X", "Y", "Z")
_JOINTS = _Numbers("PAN", "LIFT", "ELBOW", "WRIST", "ROLL")


def _goal_options(verb: F) -> F:
    """The options that name a goal; the verb gets ``goal`` and ``scene``."""

    @click.option("--xyz", type=_POINT, help="Bring the tool to this point [mm], base frame.")
    @click.option("--approach", type=_POINT, help="With --xyz: where the tool's z axis points.")
    @click.option("--line", is_flag=True, help="With --xyz: along a straight line of the tool.")
    @click.option(
        "--frame",
        type=click.Choice(["tool", "jaw_tip"]),
        default="tool",
        show_default=True,
        help="With --xyz: which frame of the hand is meant.",
    )
    @click.option("--joints", type=_JOINTS, help="Bring the joints to these angles [deg].")
    @click.option(
        "--pose",
        metavar="NAME",
        help=f"A named pose: {', '.join(pose.name for pose in POSES)}, or one of your own.",
    )
    @click.option(
        "--scene",
        "scene_file",
        type=click.Path(path_type=Path),
        help="What stands around the arm, a JSON file.",
    )
    @click.option("--speed", type=float, metavar="DEG/S", help="Joint speed cap.")
    @click.option("--acceleration", type=float, metavar="DEG/S2", help="Joint acceleration cap.")
    @functools.wraps(verb)
    def with_goal(
        *args: Any,
        xyz: np.ndarray | None,
        approach: np.ndarray | None,
        line: bool,
        frame: str,
        joints: np.ndarray | None,
        pose: str | None,
        scene_file: Path | None,
        speed: float | None,
        acceleration: float | None,
        source: AnySource,
        **kwargs: Any,
    ) -> Any:
        if sum(given is not None for given in (xyz, joints, pose)) != 1:
            raise click.UsageError("where to? give one of --xyz, --joints, --pose")
        if xyz is None and (approach is not None or line or frame != "tool"):
            raise click.UsageError("--approach, --line and --frame belong to --xyz")
        source = paced(source, speed, acceleration)
        goal = _goal(xyz, approach, line, frame, joints, pose)
        return verb(*args, goal=goal, scene_file=scene_file, source=source, **kwargs)

    return with_goal  # type: ignore[return-value]  # its own options and those above


def _goal(
    xyz: np.ndarray | None,
    approach: np.ndarray | None,
    line: bool,
    frame: str,
    joints: np.ndarray | None,
    pose: str | None,
) -> Goal:
    from so101_motion.geometry import SE3, frame_along
    from so101_motion.planning.goals import GoalMetric, JointGoal, LineGoal, PoseGoal

    if joints is not None:
        return JointGoal(q=to_rad(joints))
    if xyz is None:
        return JointGoal(q=_posed(str(pose)))
    target, metric = SE3.from_translation(to_m(xyz)), GoalMetric.POSITION_ONLY
    if approach is not None:
        if not np.any(approach):
            raise click.UsageError("--approach is a direction, such as 0,0,-1 for straight down")
        target, metric = SE3(frame_along(approach), target.p), GoalMetric.POSITION_AND_APPROACH
    kind = LineGoal if line else PoseGoal
    return kind(T_base_tool=target, metric=metric, frame=frame)


def _posed(name: str) -> Array:
    """The joint angles of a named pose, be it the arm's or the user's own."""
    from so101_motion.errors import ConfigError
    from so101_motion.pose_book import PoseBook

    try:
        return PoseBook().find(name).q
    except ConfigError as error:
        raise click.BadParameter(f"{error.value!r} {error.reason}", param_hint="--pose") from None


@click.command()
@any_source_options
@_goal_options
@click.option("--from", "q_from", type=_JOINTS, help="With --sim: where the joints stand [deg].")
@click.option("--out", type=click.Path(path_type=Path), help="Save it: .csv, .json or .mcap.")
@click.option("--lerobot", is_flag=True, help="With --out: LeRobot's names and units.")
@click.option(
    "--html", type=click.Path(path_type=Path), help="Save a film of it that any browser plays."
)
@click.option("--preview", is_flag=True, help="Show it in the browser.")
@json_option
@reports_errors
def plan(
    source: AnySource,
    goal: Goal,
    scene_file: Path | None,
    q_from: np.ndarray | None,
    out: Path | None,
    lerobot: bool,
    html: Path | None,
    preview: bool,
    as_json: bool,
) -> None:
    """Plan a motion and show it; nothing moves.

    \b
    so101 plan --sim --xyz 250,120,150
    so101 plan --sim --joints 0,-45,45,60,0 --out move.csv --html move.html
    so101 plan --sim --xyz 190,200,100 --from 65,-20,30,50,0 --scene examples/table.json
    so101 plan --machine my-arm.local:8080 --pose ready
    """  # noqa: D301
    if lerobot and out is None:
        raise click.UsageError("--lerobot belongs to --out")
    if q_from is not None:
        if not isinstance(source, Source) or source.port is not None:
            raise click.UsageError("--from belongs to --sim; a real arm stands where it stands")
        source = replace(source, q_start=to_rad(q_from))
    with quietly(), closing(source.open()) as rig:
        found = _planned(rig, goal, scene_file)
        _report(found, source, as_json)
        if out is not None:
            from so101_motion.export import export
            from so101_motion.teleoperator import lerobot_of

            export(found.trajectory, out, lerobot=lerobot_of(rig) if lerobot else None)
            click.echo(f"saved {out}", err=True)
        if html is not None:
            _film(rig, found, source, html)
        if preview:
            _show(rig, found, source)


@click.command()
@any_source_options
@_goal_options
@click.option("--yes", is_flag=True, help="Move without asking.")
@json_option
@reports_errors
def move(source: AnySource, goal: Goal, scene_file: Path | None, yes: bool, as_json: bool) -> None:
    """Plan a motion, say what it will be, and run it. Ctrl-C stops the arm.

    \b
    so101 move --port /dev/ttyACM0 --pose ready
    so101 move --sim --xyz 250,0,60 --line --yes
    so101 move --machine my-arm.local:8080 --xyz 250,0,60
    """  # noqa: D301
    with quietly(), closing(source.open()) as rig:
        found = _planned(rig, goal, scene_file)
        if not as_json:
            _report(found, source, as_json=False)
        if not yes:
            have_agreed(f"Move the {source.what} for {found.duration:.1f} s?")
        motion = rig.arm.start_execute(found)
        _wait(rig, motion, found)
        state = rig.arm.state
        off_deg = float(to_deg(np.max(np.abs(state.q - found.q_goal))))
        if as_json:
            arrived = {"q_deg": to_deg(state.q).tolist(), "off_deg": off_deg}
            print_json("move", {"source": source.what, **_facts(found), "arrived": arrived})
        else:
            p = to_mm(rig.arm.T_base().p)
            where = ", ".join(f"{x:.1f}" for x in p)
            click.echo(f"arrived: tool at ({where}) mm, joints within {off_deg:.2f} deg")


def _planned(rig: RigLike, goal: Goal, scene_file: Path | None) -> Plan:
    if scene_file is not None:
        from so101_motion.scene_file import read_scene

        rig.arm.scene = read_scene(scene_file)
    with patience("planning"):
        return rig.arm.plan(goal)


def _film(rig: RigLike, found: Plan, source: AnySource, path: Path) -> None:
    viewer = import_preview()
    title = f"{source.what[:1].upper()}{source.what[1:]}"
    film = viewer.film_of_plan(found, rig.arm.scene, title=title, q_jaw=rig.arm.state.q_jaw_ref)
    viewer.write_recording(film, path)
    click.echo(f"saved {path}", err=True)


def _report(found: Plan, source: AnySource, as_json: bool) -> None:
    if as_json:
        print_json("plan", {"source": source.what, **_facts(found)})
    else:
        click.echo(plan_table(found))


def _facts(found: Plan) -> dict[str, object]:
    report = found.report
    return {
        "joints": list(ARM_JOINTS),
        "q_start_deg": to_deg(found.q_start).tolist(),
        "q_goal_deg": to_deg(found.q_goal).tolist(),
        "duration_s": found.duration,
        "setpoints": len(found.trajectory),
        "clearance_mm": float(to_mm(report.clearance)),
        "closest": list(report.closest),
        "stages_ms": {name: round(ms, 3) for name, ms in report.stages_ms.items()},
        "path_deg": to_deg(found.path).tolist(),
    }


def _wait(rig: RigLike, motion: Motion, found: Plan) -> None:
    """Wait for the end with a bar on stderr; Ctrl-C stops the arm and waits until it rests."""
    try:
        if not sys.stderr.isatty():
            motion.result()
            return
        from rich.console import Console
        from rich.progress import Progress

        with Progress(console=Console(stderr=True), transient=True) as progress:
            task = progress.add_task("moving", total=found.duration)
            begin = rig.clock.now()
            while not motion.future.done():
                try:
                    motion.result(timeout=0.1)
                except NotYet:
                    progress.update(task, completed=rig.clock.now() - begin)
        motion.result()
    except KeyboardInterrupt:
        rig.arm.stop()
        click.echo("stopped; the arm holds", err=True)
        raise SystemExit(130) from None


def _show(rig: RigLike, found: Plan, source: AnySource) -> None:
    serve = import_preview().serve
    with serve(rig, title=source.what.capitalize(), plan=found) as page:
        click.echo(f"open   {page.url}")
        click.echo("       (whoever has this link can move the arm; Ctrl-C to quit)", err=True)
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()
