"""``so101 sweep``: run long computations on all cores or on a cluster."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from so101_motion.cli.options import JSON, argument, option, together, verb
from so101_motion.cli.param_types import (
    DIRECTION,
    IN_FILE,
    JOINTS,
    SCENE,
    SCENE_FILE,
    Finite,
    Parsed,
    read_scene,
)
from so101_motion.cli.shared import CHECK_FAILED, Verbs, aside, print_json
from so101_motion.common import interrupts
from so101_motion.common.attributes import (
    ACCELERATION_RANGE_DEG,
    HEAVIEST,
    SERVO_VOLTAGES,
    SPEED_RANGE_DEG,
)
from so101_motion.common.units import to_m, to_mm, to_rad

if TYPE_CHECKING:
    from so101_motion.common.geometry import Array
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.tasks.sweeps import Progress, SweepResult
    from so101_motion.tasks.sweeps.place import PlaceSweep, Region
    from so101_motion.tasks.sweeps.placement import Placement
    from so101_motion.tasks.sweeps.sweep import Sweep

_EVERY = 10.0  # how often progress is printed without a terminal [s]

_SHOWN = 5  # most failures that are printed one by one


@click.group(cls=Verbs)
def sweep() -> None:
    """Run large computations in pieces, such as an atlas of the reach or many plans.

    All cores but one are used unless you give --workers or --dask. The result is the same on any
    number of computers; the last line is its SHA-256. To continue after an interruption, give the
    same command again.
    """


CAPS = together(
    lambda speed, acceleration: {"velocity": to_rad(speed), "acceleration": to_rad(acceleration)},
    speed=option("Joint speed cap.", Finite(*SPEED_RANGE_DEG), 170.0, metavar="DEG/S"),
    acceleration=option(
        "Joint acceleration cap.", Finite(*ACCELERATION_RANGE_DEG), 430.0, metavar="DEG/S2"
    ),
)
PAYLOAD = together(
    lambda payload_g: 1e-3 * payload_g,
    payload_g=option("Mass in the hand [g].", Finite(0.0, 1e3 * HEAVIEST), 0.0),
)
VOLTAGE = together(
    lambda servo_voltage: float(servo_voltage),
    servo_voltage=option(
        "The servos' rated voltage.", click.Choice([f"{each:g}" for each in SERVO_VOLTAGES]),
        f"{SERVO_VOLTAGES[0]:g}",
    ),
)  # fmt: skip
OUT = option("Folder of the result.", click.Path(path_type=Path, file_okay=False), required=True)
WORKERS = option("Number of processes.", click.IntRange(1, 256))
DASK = option("A Dask scheduler: tcp://scheduler:8786.", metavar="ADDRESS")


def _runner(out: Path, workers: int | None, dask: str | None, as_json: bool) -> _Run:
    def run(work: Sweep, summary: Callable[[Path], dict[str, object]]) -> None:
        from so101_motion.tasks.sweeps import run_sweep

        with _computers(workers, dask, out) as computed_by, _show_progress(work) as show:
            result = run_sweep(work, out, on_progress=show, **computed_by)
        facts = summary(out) if not result.failed else {}
        _print_result(work, result, facts, as_json=as_json)
        if result.failed:
            raise SystemExit(CHECK_FAILED)

    return run


_Run = Callable[..., None]
_RUN = together(_runner, out=OUT, workers=WORKERS, dask=DASK, as_json=JSON)
"""Runs a sweep and prints the summary of its folder."""


@verb(sweep)
def reach(
    spacing_mm: float = option("Spacing of the points.", Finite(1.0, 200.0), 20.0),
    scene: Scene | None = SCENE,
    frame: str = option(
        "The frame of the hand that moves to the points.", click.Choice(["tool", "jaw_tip"]), "tool"
    ),
    approach: np.ndarray | None = option(
        "Direction of the tool's z axis; 0,0,-1 is from above.  [default: any]", DIRECTION
    ),
    tolerance_deg: float = option("How far the approach may be off.", Finite(0.1, 90.0), 5.0),
    payload: float = PAYLOAD,
    voltage: float = VOLTAGE,
    run: _Run = _RUN,
) -> None:
    """Make an atlas of the points that the arm reaches, and how well.

    For every point of a grid it has: whether the arm reaches it free of contact, in how many
    branches, and for the best pose its clearance, the torque that is left, and manipulability.

    \b
    so101 sweep reach --spacing-mm 20 --out atlas
    so101 sweep reach --out from-above --approach 0,0,-1 --payload-g 200
    so101 sweep reach --out on-the-table --scene examples/table.json --workers 2
    """  # noqa: D301
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.tasks.sweeps import Atlas, ReachSweep, scene_text
    from so101_motion.tasks.sweeps.reach import in_words

    work = ReachSweep(
        spacing=to_m(spacing_mm),
        scene=scene_text(scene or Scene()),
        frame=frame,
        approach=None if approach is None else tuple(approach.tolist()),
        tolerance=to_rad(tolerance_deg),
        payload=payload,
        voltage=voltage,
    )
    aside(in_words(work))
    run(work, lambda folder: _atlas_facts(Atlas.read(folder).summary()))


@verb(sweep)
def plans(
    count: int = option("Number of random problems.", click.IntRange(1, 10**9), required=True),
    seed: int = option("Random seed.", click.IntRange(0), 0),
    scene_files: tuple[Path, ...] = option(
        "A scene file; several are used in turn.", IN_FILE, name="--scene", multiple=True
    ),
    scatter_mm: float = option(
        "Move the obstacles by up to this, anew for each 100 problems.", Finite(0.0, 1000.0), 0.0
    ),
    fps: int = option("Setpoints a second.", click.IntRange(1, 100), 30),
    caps: dict[str, float] = CAPS,
    payload: float = PAYLOAD,
    run: _Run = _RUN,
) -> None:
    """Make a data set of motions: planned, timed and verified.

    Each motion goes from one random configuration to another, both free of contact and within the
    servos' torque. Names and units are LeRobot's: degrees from the middle of a joint's travel.

    \b
    so101 sweep plans --count 1000 --out motions
    so101 sweep plans --count 100000 --scene examples/table.json --scatter-mm 50 --out at-tables
    """  # noqa: D301
    from so101_motion.files.scene_file import read_scene
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.tasks.sweeps import PlansSweep, plans_summary, scene_text

    scenes = [read_scene(each) for each in scene_files] or [Scene()]
    work = PlansSweep(
        count=count,
        seed=seed,
        scenes=tuple(scene_text(each) for each in scenes),
        scatter=to_m(scatter_mm),
        velocity=caps["velocity"],
        acceleration=caps["acceleration"],
        fps=fps,
        payload=payload,
    )
    run(work, lambda folder: {name: round(v, 3) for name, v in plans_summary(folder).items()})


Ends = tuple[float, float]


def _from_to(most: float) -> Parsed:
    """A number, or two with a colon between them: from, to."""

    def read(text: str) -> tuple[float, float]:
        low, _, high = text.partition(":")
        try:
            ends = float(low), float(high or low)
        except ValueError:
            raise ValueError("is not FROM:TO, such as -200:200") from None
        if not (ends[0] <= ends[1] and max(map(abs, ends)) <= most):
            raise ValueError(f"must be two numbers within {most:g}, the smaller one first")
        return ends

    return Parsed("FROM:TO", read)


def _region(
    x_mm: Ends, y_mm: Ends, z_mm: Ends, turn_deg: Ends,
    mount: str, facing_deg: float, spacing_mm: float, turn_step_deg: float,
) -> Region:  # fmt: skip
    from so101_motion.tasks.sweeps.place import Region

    x, y, z = ((to_m(low), to_m(high)) for low, high in (x_mm, y_mm, z_mm))
    return Region(
        x=x, y=y, z=z, turn=(to_rad(turn_deg[0]), to_rad(turn_deg[1])),
        mount=mount, facing=to_rad(facing_deg),
        spacing=to_m(spacing_mm), turn_step=to_rad(turn_step_deg),
    )  # fmt: skip


_LENGTHS = _from_to(5000.0)
_REGION = together(
    _region,
    x_mm=option("Where the base may be in the cell, along x.", _LENGTHS, "-300:300"),
    y_mm=option("The same along y.", _LENGTHS, "-300:300"),
    z_mm=option("The same along z; 0 is on the table.", _LENGTHS, "0"),
    turn_deg=option("How it may be turned.", _from_to(360.0), "-180:180"),
    mount=option(
        "What it is screwed to.", click.Choice(["table", "wall", "upside-down"]), "table"
    ),
    facing_deg=option("Where a wall faces; 0 is along x.", Finite(-360.0, 360.0), 0.0),
    spacing_mm=option(
        "Distance between the places tried first; the best are refined in eighths of it.",
        Finite(4.0, 1000.0), 40.0,
    ),
    turn_step_deg=option("Angle between the turns tried first.", Finite(1.0, 180.0), 30.0),
)  # fmt: skip


@verb(sweep)
def place(
    task_file: Path = argument(IN_FILE, metavar="TASK"),
    region: Region = _REGION,
    by: str = option(
        "What to optimise; the time decides between equals.",
        click.Choice(["time", "clearance", "torque", "robust"]),
        "time",
    ),
    scene_file: Path | None = SCENE_FILE,
    cell_file: Path | None = option(
        "A cell file: its scene and its other arms, which stay where they stand.",
        IN_FILE,
        name="--cell",
    ),
    arm: str | None = option("Which arm of the cell is placed.  [default: one more]"),
    others_at: tuple[Array, ...] = option(
        "Joint angles of the other arms [deg]; the arm stays clear of all that are given."
        "  [default: folded]",
        JOINTS,
        multiple=True,
    ),
    tolerance_deg: float = option(
        "How far the tool's approach may be off at a program's waypoints.", Finite(0.1, 90.0), 10.0
    ),
    caps: dict[str, float] = CAPS,
    payload: float = PAYLOAD,
    voltage: float = VOLTAGE,
    out: Path = OUT,
    workers: int | None = WORKERS,
    dask: str | None = DASK,
    as_json: bool = JSON,
) -> None:
    """Find the best place for the base of an arm that does TASK.

    TASK is a program taught on an arm at the cell's origin, or a file of poses with tolerances.
    Every pose must be reached free of contact, and the whole cycle planned. The ten best places are
    saved with their programs, and a map of all.

    \b
    so101 sweep place wave.json --x-mm -200:200 --y-mm -200:200 --out placed
    so101 sweep place task.json --mount wall --x-mm 0 --z-mm 100:400 --out on-the-wall
    so101 sweep place task.json --cell cell.json --arm left --out beside-the-other
    """  # noqa: D301
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.tasks.sweeps import scene_text
    from so101_motion.tasks.sweeps.place import PlaceSweep
    from so101_motion.tasks.sweeps.placement import find_bases
    from so101_motion.tasks.sweeps.placement_files import write_placement
    from so101_motion.tasks.sweeps.placement_task import read_task, task_text

    if scene_file is not None and cell_file is not None:
        raise click.UsageError("give --scene or --cell, not both; a cell file has its own scene")
    scene = read_scene(scene_file)
    if cell_file is not None:
        scene = _with_others(cell_file, arm, others_at)
    elif others_at or arm:
        raise click.UsageError("--arm and --others-at need the arms of a cell file; give --cell")
    work = PlaceSweep(
        task=task_text(read_task(task_file, approach_tolerance=to_rad(tolerance_deg))),
        region=region,
        by=by,
        scene=scene_text(scene or Scene()),
        velocity=caps["velocity"],
        acceleration=caps["acceleration"],
        payload=payload,
        voltage=voltage,
    )
    with _computers(workers, dask, out) as computed_by, ExitStack() as bar:

        def step(part: PlaceSweep) -> Callable[[Progress], None]:
            bar.close()
            return bar.enter_context(_show_progress(part))

        placement = find_bases(work, out, on_step=step, **computed_by)
        write_placement(placement, work, out, arm=arm or "placed")
    _print_placement(placement, out, as_json=as_json)
    if placement.failed:
        raise SystemExit(CHECK_FAILED)


def _with_others(file: Path, placed: str | None, q_deg: tuple[Array, ...]) -> Scene:
    """The scene of a cell with its other arms at the given joint angles."""
    from so101_motion.arm.gripper import JAW_CLOSED
    from so101_motion.common.named_poses import POSES
    from so101_motion.files.cell_file import read_cell
    from so101_motion.planning.collision.apart import ROOM
    from so101_motion.planning.collision.scene import StandingArm

    cell = read_cell(file)
    names = [each.name for each in cell.arms]
    if placed is not None and placed not in names:
        raise click.UsageError(f"{file} has no arm {placed}; it has {', '.join(names)}")
    folded = next(pose.q for pose in POSES if pose.name == "rest")
    configurations = [to_rad(each) for each in q_deg] or [folded]
    at = np.array([(*q, JAW_CLOSED) for q in configurations])
    others = (
        StandingArm(name=each.name, T_base_arm=each.T_cell_base, q=at, room=ROOM)
        for each in cell.arms
        if each.name != placed
    )
    return replace(cell.scene, arms=tuple(others))


def _print_placement(placement: Placement, out: Path, *, as_json: bool) -> None:
    from so101_motion.tasks.sweeps.placement_files import in_figures

    rows = [in_figures(base) for base in placement.best]
    if as_json:
        facts = {
            "out": str(out),
            "screened": len(placement.screened),
            "planned": placement.planned,
            "failed": placement.failed,
            "best": rows,
            "sha256": placement.sha256,
        }
        print_json("sweep-place", facts)
        return
    click.echo("    x     y     z [mm]  turn [deg]  time [s]  clearance [mm]  torque left  robust")
    for number, row in enumerate(rows, 1):
        click.echo(
            f"{number:2}{row['x_mm']:5.0f}{row['y_mm']:6.0f}{row['z_mm']:6.0f}"
            f"{row['turn_deg']:17.1f}{row['time_s']:10.2f}{row['clearance_mm']:16.1f}"
            f"{row['torque_left_percent']:11.0f} %{row['robust_percent']:6.0f} %"
        )
    able = sum(base.missed == -1 for base in placement.screened)
    aside(f"{able} of {len(placement.screened)} bases reach every pose")
    aside(f"{out}: {placement.planned} planned; programs and scenes in best, map in map.svg")
    for where, why in placement.failed.items():
        aside(f"{where} failed: {why}")
    click.echo(f"sha256 {placement.sha256}")


def _atlas_facts(summary: dict[str, float]) -> dict[str, object]:
    branches = {
        f"reachable in {n} branch{'es' if n > 1 else ''}": summary[f"with_{n}_branches"]
        for n in (1, 2, 3, 4)
    }
    return {
        "points within the joint limits": summary["within_limits"],
        "free of contact": summary["free"],
        "reachable": summary["reachable"],
        "reachable volume [l]": round(1e3 * summary["volume_m3"], 2),
        **branches,
        "median clearance [mm]": round(to_mm(summary["median_clearance"]), 1),
        "median torque left [%]": round(100.0 * summary["median_torque_left"], 1),
    }


@contextmanager
def _computers(workers: int | None, dask: str | None, out: Path) -> Iterator[dict[str, Any]]:
    """Start processes or connect to a cluster; gives the arguments for ``run_sweep``."""
    from so101_motion.tasks.sweeps import WorkerPool

    if workers is not None and dask is not None:
        raise click.UsageError("give --workers or --dask, not both")
    try:
        if dask is None:
            with WorkerPool(workers) as pool:
                yield {"executor": pool, "ahead": pool.ahead}
            return
        from so101_motion.tasks.sweeps.engine import dask_executor

        with dask_executor(dask) as (executor, ahead):
            yield {"executor": executor, "ahead": ahead}
    except KeyboardInterrupt:
        kept = f"finished pieces are kept in {out}, give the same command to continue"
        raise interrupts.ToldInterrupt(kept) from None


@contextmanager
def _show_progress(work: Sweep) -> Iterator[Callable[[Progress], None]]:
    """Show progress: a bar on a terminal, otherwise a line every few seconds."""
    due = time.monotonic() + _EVERY

    def tell(progress: Progress) -> None:
        nonlocal due
        if time.monotonic() >= due:
            due = time.monotonic() + _EVERY
            aside(f"{progress.done} of {progress.shards}: {_in_words(progress, work.unit)}")

    if not sys.stderr.isatty():
        yield tell
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    columns = (BarColumn(), TaskProgressColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=work.shards)

        def show(progress: Any) -> None:
            done = progress.done + progress.failed
            bar.update(task, completed=done, description=_in_words(progress, work.unit))

        yield show


def _in_words(progress: Progress, unit: str) -> str:
    left = ""
    if progress.left is not None:
        minutes, seconds = divmod(round(progress.left), 60)
        hours, minutes = divmod(minutes, 60)
        left = f", {hours}:{minutes:02}:{seconds:02} left"
    failed = f", {progress.failed} failed" if progress.failed else ""
    rate = f"{progress.rate:,.0f}" if progress.rate >= 10.0 else f"{progress.rate:.2g}"
    return f"{rate} {unit} a second{left}{failed}"


def _print_result(
    work: Sweep, result: SweepResult, facts: dict[str, object], *, as_json: bool
) -> None:
    for shard, why in sorted(result.failed.items())[:_SHOWN]:
        aside(f"shard {shard} failed: {why}")
    if len(result.failed) > _SHOWN:
        aside(f"and {len(result.failed) - _SHOWN} more; sweep.json has all of them")
    if as_json:
        whole = {
            "out": str(result.folder),
            "shards": result.shards,
            "computed": result.computed,
            "failed": {str(shard): why for shard, why in result.failed.items()},
            "result": facts,
            "sha256": result.sha256,
        }
        print_json(f"sweep-{work.kind}", whole)
        return
    for name, value in facts.items():
        click.echo(f"{name + ':':<34}{value}")
    done = result.shards - len(result.failed)
    aside(f"{result.folder}: {done} of {result.shards} shards, {result.computed} of them now")
    click.echo(f"sha256 {result.sha256}")
