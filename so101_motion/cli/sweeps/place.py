"""``so101 sweep place``: find the best places for the base of an arm, or of two, for tasks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from so101_motion.cli.param_types import IN_FILE, Finite, Numbers
from so101_motion.cli.shared import CHECK_FAILED, aside, json_option, print_json
from so101_motion.cli.sweeps.options import (
    caps_options,
    computing_options,
    payload_option,
    voltage_option,
)
from so101_motion.common.units import to_m, to_rad

if TYPE_CHECKING:
    from so101_motion.common.geometry import Array
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.tasks.sweeps import Progress
    from so101_motion.tasks.sweeps.mounting import FixedArm
    from so101_motion.tasks.sweeps.pair_placement import PairPlacement
    from so101_motion.tasks.sweeps.place import PlaceSweep
    from so101_motion.tasks.sweeps.placement import Placement

V = TypeVar("V")

_FARTHEST_MM = 5000.0
_JOINTS = Numbers("PAN", "LIFT", "ELBOW", "WRIST", "ROLL", most=360.0)

_each = partial(click.option, multiple=True, show_default=True)
"""An option that may be given twice, once for each of two arms."""


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


@click.command()
@click.argument("task_files", metavar="TASK [TASK]", nargs=-1, required=True, type=IN_FILE)
@_each(
    "--x-mm", type=FromTo(_FARTHEST_MM), default=["-300:300"],
    help="Where the base may be in the cell, along x; give it twice for two arms.",
)  # fmt: skip
@_each("--y-mm", type=FromTo(_FARTHEST_MM), default=["-300:300"], help="The same along y.")
@_each(
    "--z-mm", type=FromTo(_FARTHEST_MM), default=["0"], help="The same along z; 0 is on the table."
)
@_each("--turn-deg", type=FromTo(360.0), default=["-180:180"], help="How it may be turned.")
@_each(
    "--mount", type=click.Choice(["table", "wall", "upside-down"]), default=["table"],
    help="What it is screwed to.",
)  # fmt: skip
@_each(
    "--facing-deg", type=Finite(-360.0, 360.0), default=[0.0],
    help="Where a wall faces; 0 is along x.",
)  # fmt: skip
@click.option(
    "--spacing-mm", type=Finite(4.0, 1000.0), default=40.0, show_default=True,
    help="Distance between the places tried first; the best are refined in eighths of it.",
)  # fmt: skip
@click.option(
    "--turn-step-deg",
    type=Finite(1.0, 180.0),
    default=30.0,
    show_default=True,
    help="Angle between the turns tried first.",
)
@click.option(
    "--by", type=click.Choice(["time", "clearance", "torque", "robust"]), default="time",
    show_default=True, help="What to optimise; the time decides between equals.",
)  # fmt: skip
@click.option("--scene", "scene_file", type=IN_FILE, help="A scene file: the obstacles there.")
@click.option(
    "--cell", "cell_file", type=IN_FILE,
    help="A cell file: its scene and its other arms, which stay where they stand.",
)  # fmt: skip
@click.option(
    "--arm", multiple=True,
    help="Which arm of the cell is placed, twice for two; without --cell its name."
    "  [default: one more]",
)  # fmt: skip
@click.option(
    "--others-at", type=_JOINTS, multiple=True,
    help="Joint angles of the other arms [deg]; the arm stays clear of all that are given."
    "  [default: folded]",
)  # fmt: skip
@click.option(
    "--tolerance-deg", type=Finite(0.1, 90.0), default=10.0, show_default=True,
    help="How far the tool's approach may be off at a program's waypoints.",
)  # fmt: skip
@caps_options
@payload_option
@voltage_option
@computing_options
@json_option
def place(
    task_files: tuple[Path, ...],
    x_mm: tuple[tuple[float, float], ...],
    y_mm: tuple[tuple[float, float], ...],
    z_mm: tuple[tuple[float, float], ...],
    turn_deg: tuple[tuple[float, float], ...],
    mount: tuple[str, ...],
    facing_deg: tuple[float, ...],
    spacing_mm: float,
    turn_step_deg: float,
    by: str,
    scene_file: Path | None,
    cell_file: Path | None,
    arm: tuple[str, ...],
    others_at: tuple[Array, ...],
    tolerance_deg: float,
    speed: float,
    acceleration: float,
    payload_g: float,
    servo_voltage: str,
    out: Path,
    workers: int | None,
    dask: str | None,
    as_json: bool,
) -> None:
    """Find the best place for the base of an arm that does TASK.

    TASK is a program taught on an arm at the cell's origin, or a file of poses with tolerances.
    Every pose must be reached free of contact, and the whole cycle planned. The ten best places are
    saved with their programs, and a map of all. Two tasks are for two arms, which are placed so
    that they keep apart at every point of their paths.

    \b
    so101 sweep place wave.json --x-mm -200:200 --y-mm -200:200 --out placed
    so101 sweep place task.json --mount wall --x-mm 0 --z-mm 100:400 --out on-the-wall
    so101 sweep place task.json --cell cell.json --arm left --out beside-the-other
    so101 sweep place left.json right.json --y-mm 0:300 --y-mm -300:0 --out two-arms
    """  # noqa: D301
    from so101_motion.cli.sweeps.sweep import computers, show_progress
    from so101_motion.files.scene_file import read_scene
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.tasks.sweeps import scene_text
    from so101_motion.tasks.sweeps.mounting import Region
    from so101_motion.tasks.sweeps.pair_placement import find_pairs
    from so101_motion.tasks.sweeps.place import PlaceSweep
    from so101_motion.tasks.sweeps.placement import find_bases
    from so101_motion.tasks.sweeps.placement_files import write_pairs, write_placement
    from so101_motion.tasks.sweeps.placement_task import read_task, task_text

    names = _names(task_files, arm)
    if scene_file is not None and cell_file is not None:
        raise click.UsageError("give --scene or --cell, not both; a cell file has its own scene")
    scene = Scene() if scene_file is None else read_scene(scene_file)
    others: tuple[FixedArm, ...] = ()
    if cell_file is not None:
        scene, others = _others(cell_file, arm, others_at)
    elif others_at or (arm and len(task_files) == 1):
        raise click.UsageError("--arm and --others-at need the arms of a cell file; give --cell")
    sweeps = []
    for k, task_file in enumerate(task_files):
        of = partial(_of_arm, k, len(task_files))
        region = Region(
            x=_ends(to_m, of("--x-mm", x_mm)), y=_ends(to_m, of("--y-mm", y_mm)),
            z=_ends(to_m, of("--z-mm", z_mm)), turn=_ends(to_rad, of("--turn-deg", turn_deg)),
            mount=of("--mount", mount), facing=to_rad(of("--facing-deg", facing_deg)),
            spacing=to_m(spacing_mm), turn_step=to_rad(turn_step_deg),
        )  # fmt: skip
        task = read_task(task_file, approach_tolerance=to_rad(tolerance_deg))
        sweeps.append(
            PlaceSweep(
                task=task_text(task),
                region=region,
                by=by,
                scene=scene_text(scene),
                others=others,
                velocity=to_rad(speed),
                acceleration=to_rad(acceleration),
                payload=1e-3 * payload_g,
                voltage=float(servo_voltage),
            )
        )
    with computers(workers, dask, out) as computed_by, ExitStack() as bar:

        def step(work: PlaceSweep) -> Callable[[Progress], None]:
            bar.close()
            return bar.enter_context(show_progress(work))

        if len(sweeps) == 1:
            placement = find_bases(sweeps[0], out, on_step=step, **computed_by)
            write_placement(placement, sweeps[0], out, arm=names[0])
            failed = placement.failed
            show = partial(_print, placement)
        else:
            two = sweeps[0], sweeps[1]
            pairs = find_pairs(two, out, on_step=step, **computed_by)
            write_pairs(pairs, two, out, (names[0], names[1]))
            failed = {**pairs.each[0].failed, **pairs.each[1].failed}
            show = partial(_print_pairs, pairs, (names[0], names[1]))
    show(out, as_json=as_json)
    if failed:
        raise SystemExit(CHECK_FAILED)


def _names(task_files: Sequence[Path], arms: Sequence[str]) -> tuple[str, ...]:
    """The names of the placed arms: from ``--arm``, or from the files of their tasks."""
    if len(task_files) > 2:
        raise click.UsageError(f"{len(task_files)} tasks are too many; give one or two")
    if arms and len(arms) != len(task_files):
        raise click.UsageError("give --arm once for each TASK, or not at all")
    names = tuple(arms or (path.stem for path in task_files))
    if len(set(names)) < len(names):
        raise click.UsageError(
            f"both arms are called {names[0]}; name them: --arm left --arm right"
        )
    return names if arms or len(names) > 1 else ("placed",)


def _of_arm(which: int, arms: int, option: str, values: Sequence[V]) -> V:
    """An option's value for one arm: given once for both, or once for each."""
    if len(values) not in (1, arms):
        raise click.UsageError(
            f"{option} is given {len(values)} times for {arms} arms; give it once, or for each"
        )
    return values[which] if len(values) == arms else values[0]


def _others(
    file: Path, placed: Sequence[str], q_deg: tuple[Array, ...]
) -> tuple[Scene, tuple[FixedArm, ...]]:
    """The scene of a cell, and its other arms at the given joint angles."""
    from so101_motion.arm.gripper import JAW_CLOSED
    from so101_motion.common.named_poses import POSES
    from so101_motion.files.cell_file import read_cell
    from so101_motion.tasks.sweeps.mounting import FixedArm

    cell = read_cell(file)
    names = [each.name for each in cell.arms]
    for name in placed:
        if name not in names:
            raise click.UsageError(f"{file} has no arm {name}; it has {', '.join(names)}")
    folded = next(pose.q for pose in POSES if pose.name == "rest")
    q = [to_rad(each) for each in q_deg] or [folded]
    others = []
    for each in cell.arms:
        if each.name in placed:
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
    click.echo(f"  {_PLACE_HEADS}{_FIGURE_HEADS}")
    for number, row in enumerate(rows, 1):
        click.echo(f"{number:2}{_place(row)}{_figures(row)}")
    _print_rest((placement,), out, f"{placement.planned} planned; {_IN_BEST}, map in map.svg")
    click.echo(f"sha256 {placement.sha256}")


def _print_pairs(pairs: PairPlacement, names: tuple[str, str], out: Path, *, as_json: bool) -> None:
    from so101_motion.tasks.sweeps.placement_files import pair_in_figures

    rows = [pair_in_figures(pair, names) for pair in pairs.best]
    if as_json:
        print_json(
            "sweep-place",
            {
                "out": str(out),
                "held": pairs.held,
                "failed": [each.failed for each in pairs.each],
                "best": rows,
                "sha256": pairs.sha256,
            },
        )
        return
    wide = max(map(len, names))
    click.echo(f"  {'':{wide + 1}}{_PLACE_HEADS}{_FIGURE_HEADS}")
    for number, row in enumerate(rows, 1):
        for name in names:
            start = f"{number:2}" if name == names[0] else "  "
            base = row["arms"][name]
            click.echo(f"{start} {name:{wide}}{_place(base)}{_figures(base)}")
    held = f"{pairs.held} pairs compared; {_IN_BEST}, maps beside them"
    _print_rest(pairs.each, out, held)
    click.echo(f"sha256 {pairs.sha256}")


_PLACE_HEADS = "    x     y     z [mm]  turn [deg]"
_FIGURE_HEADS = "  time [s]  clearance [mm]  torque left  robust"
_IN_BEST = "programs and scenes in best"


def _place(row: Mapping[str, float]) -> str:
    return f"{row['x_mm']:5.0f}{row['y_mm']:6.0f}{row['z_mm']:6.0f}{row['turn_deg']:17.1f}"


def _figures(row: Mapping[str, float]) -> str:
    return (
        f"{row['time_s']:10.2f}{row['clearance_mm']:16.1f}"
        f"{row['torque_left_percent']:11.0f} %{row['robust_percent']:6.0f} %"
    )


def _print_rest(placements: Sequence[Placement], out: Path, rest: str) -> None:
    for each in placements:
        able = sum(base.missed == -1 for base in each.screened)
        aside(f"{able} of {len(each.screened)} bases reach every pose")
    aside(f"{out}: {rest}")
    for each in placements:
        for where, why in each.failed.items():
            aside(f"{where} failed: {why}")
