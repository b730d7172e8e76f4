"""``so101 plan`` and ``so101 move``: plan a motion to a goal; ``move`` also runs it."""

from __future__ import annotations

import shutil
import sys
import time
from concurrent.futures import wait
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from so101_motion.cli.completion import completed_poses
from so101_motion.cli.options import JSON, YES, flag, option, together, verb
from so101_motion.cli.param_types import DIRECTION, JOINTS, POINT, SCENE, OutFile
from so101_motion.cli.shared import (
    aside,
    busy_message,
    import_preview,
    print_json,
    quietly,
    stops_on_ctrl_c,
)
from so101_motion.cli.sources import ANY_SOURCE, AnySource, Source, ending, paced
from so101_motion.common.named_poses import POSES
from so101_motion.common.realtime import LOOK_FOR_SIGNALS
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import in_mm, to_deg, to_m, to_mm, to_rad
from so101_motion.drivers.bus.ticks import RAD_PER_TICK

if TYPE_CHECKING:
    from so101_motion.arm.motion_handle import Motion
    from so101_motion.common.encoder_zeros import EncoderZeros
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.planning.goals import Goal
    from so101_motion.planning.request import Plan
    from so101_motion.rig.protocols import RigLike


def _goal(
    xyz: np.ndarray | None,
    approach: np.ndarray | None,
    line: bool,
    frame: str,
    joints: np.ndarray | None,
    pose: str | None,
    leave_contact: bool,
) -> Goal | str:
    """The goal; of a named pose its name, for its angles depend on the arm's zeros."""
    from so101_motion.common.geometry import SE3, frame_along
    from so101_motion.planning.goals import (
        GoalMetric,
        JointGoal,
        LeaveContactGoal,
        LineGoal,
        PoseGoal,
    )

    given = [each for each in (xyz, joints, pose, leave_contact or None) if each is not None]
    if len(given) != 1:
        raise click.UsageError("give one goal: --xyz, --joints, --pose or --leave-contact")
    if xyz is None and (approach is not None or line or frame != "tool"):
        raise click.UsageError("--approach, --line and --frame belong to --xyz")
    if leave_contact:
        return LeaveContactGoal()
    if joints is not None:
        return JointGoal(q=to_rad(joints))
    if xyz is None:
        _pose(str(pose))  # refuses a name that is none before the arm is opened
        return str(pose)
    target, metric = SE3.from_translation(to_m(xyz)), GoalMetric.POSITION_ONLY
    if approach is not None:
        if np.linalg.norm(approach) < 1e-6:
            raise click.UsageError("--approach is a direction, such as 0,0,-1 for straight down")
        target, metric = SE3(frame_along(approach), target.p), GoalMetric.POSITION_AND_APPROACH
    kind = LineGoal if line else PoseGoal
    return kind(T_base_tool=target, metric=metric, frame=frame)


_GOAL = together(
    _goal,
    xyz=option("Move the tool to this point [mm], base frame.", POINT),
    approach=option("With --xyz: direction of the tool's z axis, such as 0,0,-1.", DIRECTION),
    line=flag("With --xyz: move the tool along a straight line."),
    frame=option(
        "With --xyz: the frame of the gripper that moves to the point: tool, jaw_tip, or one of the"
        " --tool, such as tcp.",
        str, "tool", metavar="NAME",
    ),
    joints=option("Move the joints to these angles [deg].", JOINTS),
    pose=option(
        f"A named pose: {', '.join(pose.name for pose in POSES)}, or one of your own.",
        metavar="NAME", shell_complete=completed_poses,
    ),
    leave_contact=flag(
        "The goal is to be free: leave the table or an obstacle slowly and straight."
        " In a surface of which the inside is not known this may lead deeper."
    ),
)  # fmt: skip


_EFFORT = option(
    "How many routes are compared where the straight one is blocked.", click.IntRange(1, 10_000), 16
)


def _pose(name: str, zeros: EncoderZeros | None = None) -> Goal:
    """A named pose, built in or the user's own, of an arm with these zeros."""
    from so101_motion.common.errors import ConfigError, quoted
    from so101_motion.files.saved_poses import SavedPoses
    from so101_motion.planning.goals import JointGoal

    try:
        return JointGoal(q=SavedPoses(zeros=lambda: zeros).find(name).q)
    except ConfigError as error:
        raise click.BadParameter(
            f"{quoted(error.value)} {error.reason}", param_hint="'--pose'"
        ) from None


@verb()
def plan(
    source: AnySource = paced(ANY_SOURCE),
    goal: Goal | str = _GOAL,
    scene: Scene | None = SCENE,
    route_effort: int = _EFFORT,
    q_from: np.ndarray | None = option(
        "With --sim: the start of the joints [deg].", JOINTS, name="--from"
    ),
    out: Path | None = option("Save the motion: .csv, .json or .mcap.", OutFile()),
    html: Path | None = option("Save a film of it for any browser.", OutFile(".html", ".htm")),
    preview: bool = flag("Show the motion in the browser."),
    as_json: bool = JSON,
) -> None:
    """Plan a motion and show it; nothing moves.

    \b
    so101 plan --sim --xyz 250,120,150
    so101 plan --sim --joints 0,-45,45,60,0 --out move.csv --html move.html
    so101 plan --sim --xyz 190,200,100 --from 65,-20,30,50,0 --scene examples/table.json
    so101 plan --machine my-arm.local:8080 --pose ready
    """  # noqa: D301
    if out is not None:  # refuses what the plan could not be saved to, before planning
        from so101_motion.files.trajectory_export import check_name, export

        check_name(out.name)
    if q_from is not None:
        if not isinstance(source, Source) or source.port is not None:
            raise click.UsageError("--from works only with --sim; leave it out for a real arm")
        source = replace(source, q_start=to_rad(q_from))
    viewer: Any = import_preview() if preview or html is not None else None
    from so101_motion.arm.planning_worker import planner_started

    with planner_started(), quietly(), closing(source.open_to_look()) as rig:
        found = _planned(rig, goal, scene, route_effort)
        if not as_json:
            click.echo(plan_table(found))
        if out is not None:
            export(found.trajectory, out)
            aside(f"saved {out}")
        if html is not None:
            film = viewer.film_of_plan(
                found, rig.arm.scene, title=source.title, q_jaw=rig.arm.state.q_jaw_ref
            )
            viewer.write_recording(film, html)
            aside(f"saved {html}")
        if as_json:  # last, so that the files exist when a program reads it
            print_json("plan", {"source": source.what, **_facts(found)})
        if preview:
            _show(viewer, rig, found, source)


@verb()
def move(
    source: AnySource = ending(paced(ANY_SOURCE)),
    goal: Goal | str = _GOAL,
    scene: Scene | None = SCENE,
    route_effort: int = _EFFORT,
    yes: bool = YES,
    as_json: bool = JSON,
) -> None:
    """Plan a motion, show it, and run it. Ctrl-C stops the arm.

    \b
    so101 move --port /dev/ttyACM0 --pose ready
    so101 move --sim --xyz 250,0,60 --line --yes
    so101 move --machine my-arm.local:8080 --xyz 250,0,60
    """  # noqa: D301
    planned_move(source, goal, scene, route_effort, yes, as_json)


def planned_move(
    source: AnySource, goal: Goal | str, scene: Scene | None, effort: int, yes: bool, as_json: bool
) -> None:
    """Plan, show, ask, move and tell where it arrived."""
    with quietly(), closing(source.open()) as rig:
        rig.arm.state.reading.check_held(ARM_JOINTS)  # rather than what a sunken arm lies on
        found = _planned(rig, goal, scene, effort)
        is_there = is_still(found) and source.at_end == "hold"
        if not is_there:
            if not as_json:
                click.echo(plan_table(found))
            source.have_agreed(rig, f"Move the {source.what} for {found.duration:.1f} s?", yes)
            _wait(rig, rig.arm.move(found, wait=False), found)
        state = rig.arm.state
        off_deg = float(to_deg(np.max(np.abs(state.q - found.q_goal))))
        if as_json:
            arrived = {"q_deg": to_deg(state.q).tolist(), "off_deg": off_deg}
            print_json("move", {"source": source.what, **_facts(found), "arrived": arrived})
        else:
            how, where = "already there" if is_there else "arrived", in_mm(rig.arm.T_base().p)
            click.echo(f"{how}: tool at {where}, joints within {off_deg:.2f} deg")


def _planned(rig: RigLike, goal: Goal | str, scene: Scene | None, effort: int) -> Plan:
    from so101_motion.planning.request import Search

    if isinstance(goal, str):
        goal = _pose(goal, rig.connection.encoder_zeros)
    if scene is not None:
        rig.arm.scene = scene
    with busy_message("planning"):
        return rig.arm.plan(goal, search=Search(route_effort=effort))


def is_still(plan: Plan) -> bool:
    """Whether it moves no joint by as much as its encoder tells apart."""
    return float(np.ptp(plan.trajectory.q, axis=0).max()) < RAD_PER_TICK


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
        "routes": report.routes,
        "out_of_time": report.out_of_time,
        "stages_ms": {name: round(ms, 3) for name, ms in report.stages_ms.items()},
        "path_deg": to_deg(found.path).tolist(),
    }


_NUMBERS, _SPARKS = 40, 40  # columns; chosen: together the width of a usual terminal


def plan_table(plan: Plan) -> str:
    from so101_motion.planning.plan_summary import tool_length

    if is_still(plan):
        return "the arm is already there: no joint moves"
    trajectory = plan.trajectory
    travel_deg = to_deg(trajectory.q[-1] - trajectory.q[0])
    peak_deg = to_deg(np.max(np.abs(trajectory.qd), axis=0))
    tool_mm = to_mm(tool_length(plan))
    width = min(shutil.get_terminal_size().columns - _NUMBERS, _SPARKS)
    planned_ms = plan.report.stages_ms["total"]
    lines = [
        f"{plan.duration:.2f} s, {len(trajectory)} setpoints {1e3 * trajectory.dt:g} ms apart, "
        f"tool path {tool_mm:.0f} mm, planned in {planned_ms:.1f} ms"
        + (" (the time was up, a quicker route may exist)" if plan.report.out_of_time else ""),
        plan.report.short_of_drive,
        f"{'joint':<14}{'travel':>10}{'peak speed':>13}   speed over time"[
            : _NUMBERS + max(width, 0)
        ],
    ]
    for i, joint in enumerate(ARM_JOINTS):
        lines.append(
            f"{joint:<14}{travel_deg[i]:>z6.1f} deg{peak_deg[i]:>7.1f} deg/s   "
            + _sparkline(np.abs(trajectory.qd[:, i]), float(np.max(plan.limits.velocity)), width)
        )
    return "\n".join(line.rstrip() for line in lines)


def _sparkline(values: np.ndarray, top: float, width: int) -> str:
    if width < 1:
        return ""
    bars = " ▁▂▃▄▅▆▇█"
    columns = [float(np.max(part)) for part in np.array_split(values, min(width, len(values)))]
    return "".join(bars[round(min(value / top, 1.0) * (len(bars) - 1))] for value in columns)


def _wait(rig: RigLike, motion: Motion, found: Plan) -> None:
    """Wait for the end with a progress bar; Ctrl-C stops the arm and waits until it rests."""
    with stops_on_ctrl_c(rig.arm):
        if not sys.stderr.isatty():
            motion.result()
            return
        from rich.console import Console
        from rich.progress import Progress

        with Progress(console=Console(stderr=True), transient=True) as progress:
            task = progress.add_task("moving", total=found.duration)
            begin = rig.clock.now()
            while not wait((motion.future,), 0.1).done:
                progress.update(task, completed=rig.clock.now() - begin)
        motion.result()


def _show(viewer: Any, rig: RigLike, found: Plan, source: AnySource) -> None:
    with viewer.serve(rig, title=source.title, plan=found) as page:
        aside(f"open   {page.url}")
        aside("       (anyone with this link can move the arm; Ctrl-C to quit)")
        while True:
            time.sleep(LOOK_FOR_SIGNALS)
