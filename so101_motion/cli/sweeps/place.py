"""``so101 sweep place``: find the best places for the base of an arm that does a task."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from so101_motion.cli.options import JSON, argument, option, together, verb
from so101_motion.cli.param_types import IN_FILE, JOINTS, SCENE_FILE, Finite, read_scene
from so101_motion.cli.shared import CHECK_FAILED, aside, print_json
from so101_motion.cli.sweeps.sweep import (
    CAPS,
    DASK,
    OUT,
    PAYLOAD,
    VOLTAGE,
    WORKERS,
    computers,
    show_progress,
)
from so101_motion.cli.sweeps.sweep import sweep as sweep
from so101_motion.common.units import to_m, to_rad

if TYPE_CHECKING:
    from so101_motion.common.geometry import Array
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.tasks.sweeps import Progress
    from so101_motion.tasks.sweeps.mounting import FixedArm, Region
    from so101_motion.tasks.sweeps.place import PlaceSweep
    from so101_motion.tasks.sweeps.placement import Placement

_FARTHEST_MM = 5000.0


class FromTo(click.ParamType[tuple[float, float]]):
    """A number, or two with a colon between them: from, to."""

    name = "FROM:TO"

    def __init__(self, most: float) -> None:
        self._most = most

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float]:
        """Read both ends, the smaller one first."""
        if isinstance(value, tuple):
            return value
        try:
            low, _, high = str(value).partition(":")
            ends = float(low), float(high or low)
        except ValueError:
            self.fail(f"{value!r} is not FROM:TO, such as -200:200", param, ctx)
        if not (ends[0] <= ends[1] and max(map(abs, ends)) <= self._most):
            self.fail(
                f"{value!r} must be two numbers within {self._most:g}, the smaller one first",
                param, ctx,
            )  # fmt: skip
        return ends


def _region(
    x_mm: tuple[float, float],
    y_mm: tuple[float, float],
    z_mm: tuple[float, float],
    turn_deg: tuple[float, float],
    mount: str,
    facing_deg: float,
    spacing_mm: float,
    turn_step_deg: float,
) -> Region:
    from so101_motion.tasks.sweeps.mounting import Region

    return Region(
        x=_ends(to_m, x_mm), y=_ends(to_m, y_mm), z=_ends(to_m, z_mm),
        turn=_ends(to_rad, turn_deg), mount=mount, facing=to_rad(facing_deg),
        spacing=to_m(spacing_mm), turn_step=to_rad(turn_step_deg),
    )  # fmt: skip


_REGION = together(
    _region,
    x_mm=option("Where the base may be in the cell, along x.", FromTo(_FARTHEST_MM), "-300:300"),
    y_mm=option("The same along y.", FromTo(_FARTHEST_MM), "-300:300"),
    z_mm=option("The same along z; 0 is on the table.", FromTo(_FARTHEST_MM), "0"),
    turn_deg=option("How it may be turned.", FromTo(360.0), "-180:180"),
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
    others: tuple[FixedArm, ...] = ()
    if cell_file is not None:
        scene, others = _others(cell_file, arm, others_at)
    elif others_at or arm:
        raise click.UsageError("--arm and --others-at need the arms of a cell file; give --cell")
    sweep = PlaceSweep(
        task=task_text(read_task(task_file, approach_tolerance=to_rad(tolerance_deg))),
        region=region,
        by=by,
        scene=scene_text(scene or Scene()),
        others=others,
        velocity=caps["velocity"],
        acceleration=caps["acceleration"],
        payload=payload,
        voltage=voltage,
    )
    with computers(workers, dask, out) as computed_by, ExitStack() as bar:

        def step(work: PlaceSweep) -> Callable[[Progress], None]:
            bar.close()
            return bar.enter_context(show_progress(work))

        placement = find_bases(sweep, out, on_step=step, **computed_by)
        write_placement(placement, sweep, out, arm=arm or "placed")
    _print(placement, out, as_json=as_json)
    if placement.failed:
        raise SystemExit(CHECK_FAILED)


def _others(
    file: Path, placed: str | None, q_deg: tuple[Array, ...]
) -> tuple[Scene, tuple[FixedArm, ...]]:
    """The scene of a cell, and its other arms at the given joint angles."""
    from so101_motion.arm.gripper import JAW_CLOSED
    from so101_motion.common.named_poses import POSES
    from so101_motion.files.cell_file import read_cell
    from so101_motion.tasks.sweeps.mounting import FixedArm

    cell = read_cell(file)
    names = [each.name for each in cell.arms]
    if placed is not None and placed not in names:
        raise click.UsageError(f"{file} has no arm {placed}; it has {', '.join(names)}")
    folded = next(pose.q for pose in POSES if pose.name == "rest")
    q = [to_rad(each) for each in q_deg] or [folded]
    others = []
    for each in cell.arms:
        if each.name == placed:
            continue
        x, y, z = each.T_cell_base.p.tolist()
        roll, pitch, yaw = each.T_cell_base.rpy.tolist()
        configurations = tuple((*of.tolist(), JAW_CLOSED) for of in q)
        others.append(
            FixedArm(name=each.name, position=(x, y, z), rpy=(roll, pitch, yaw), q=configurations)
        )
    return cell.scene, tuple(others)


def _ends(convert: Callable[[float], float], ends: tuple[float, float]) -> tuple[float, float]:
    return convert(ends[0]), convert(ends[1])


def _print(placement: Placement, out: Path, *, as_json: bool) -> None:
    from so101_motion.tasks.sweeps.placement_files import in_figures

    rows = [in_figures(base) for base in placement.best]
    if as_json:
        print_json(
            "sweep-place",
            {
                "out": str(out),
                "screened": len(placement.screened),
                "planned": placement.planned,
                "failed": placement.failed,
                "best": rows,
                "sha256": placement.sha256,
            },
        )
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
