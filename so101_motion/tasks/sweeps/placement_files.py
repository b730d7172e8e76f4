"""Write the result of a search for bases: a table, a map, and a program and scene for each base."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

from so101_motion.common.units import to_deg, to_mm
from so101_motion.files import atomic
from so101_motion.files.cell_file import CellArm, CellFile, write_cell
from so101_motion.files.scene_file import write_scene
from so101_motion.tasks.program.files import write as write_program
from so101_motion.tasks.sweeps.place import PlaceSweep
from so101_motion.tasks.sweeps.placement import Base, Placement
from so101_motion.tasks.sweeps.placement_task import task_from
from so101_motion.tasks.sweeps.reach import scene_in

_PIXELS_PER_M = 800.0
_BORDER = 60.0
_GOOD, _BAD, _NONE = (43, 138, 62), (255, 236, 153), "#e9ecef"


def write_placement(
    placement: Placement, sweep: PlaceSweep, folder: Path, *, arm: str = "placed"
) -> None:
    """Write ``placement.json``, ``map.svg``, and the ten best into ``best/``.

    ``best/01.json`` is the program for an arm at the best base, ``best/01-scene.json`` its scene,
    both in the frame of that base. With other arms, ``best/01-cell.json`` is the cell with all of
    them, in which this one has the name ``arm``.
    """
    best = folder / "best"
    best.mkdir(exist_ok=True)
    task = task_from(json.loads(sweep.task))
    scene = scene_in(sweep.scene)
    for number, base in enumerate(placement.best, 1):
        T_cell_base = sweep.region.base(base.lattice_index)
        write_program(task.program(base.q), best / f"{number:02d}.json")
        write_scene(sweep.region.seen_from(scene, T_cell_base), best / f"{number:02d}-scene.json")
        if scene.arms:
            arms = {arm: T_cell_base, **{each.name: each.T_base_arm for each in scene.arms}}
            placed = tuple(CellArm(name=name, T_cell_base=T) for name, T in arms.items())
            cell = CellFile(arms=placed, scene=replace(scene, attached=(), arms=()))
            write_cell(cell, best / f"{number:02d}-cell.json")
    rows = [in_figures(base) for base in placement.best]
    table = json.dumps({"by": sweep.by, "sha256": placement.sha256, "best": rows}, indent=1)
    atomic.write(folder / "placement.json", (table + "\n").encode())
    atomic.write(folder / "map.svg", placement_map(placement, sweep).encode())


def in_figures(base: Base) -> dict[str, Any]:
    return {
        "x_mm": round(to_mm(base.x), 1),
        "y_mm": round(to_mm(base.y), 1),
        "z_mm": round(to_mm(base.z), 1),
        "turn_deg": round(to_deg(base.turn), 2),
        "time_s": round(base.time, 3),
        "clearance_mm": round(to_mm(base.clearance), 1),
        "torque_left_percent": round(100.0 * base.torque_left, 1),
        "robust_percent": round(100.0 * base.robust, 1),
    }


def placement_map(placement: Placement, sweep: PlaceSweep) -> str:
    """Draw the first round and the best bases as SVG, seen from above; on a wall, from the side.

    The colour of a field is the best bound of its bases, over all turns: greener is faster. Circles
    with a number are the best bases, with a stroke in the direction that they face; dots are the
    poses, black squares other arms.
    """
    task, arms = task_from(json.loads(sweep.task)), scene_in(sweep.scene).arms
    places = {
        each.lattice_index: sweep.region.place(each.lattice_index) for each in placement.screened
    }
    across, up = _axes(sweep)
    bound: dict[tuple[float, float], float] = {}
    for each in placement.screened:
        at = places[each.lattice_index][across], places[each.lattice_index][up]
        bound[at] = min(bound.get(at, math.inf), each.time)
    left = min(x for x, _ in bound)
    top = max(y for _, y in bound)
    right, bottom = max(x for x, _ in bound), min(y for _, y in bound)
    points = [pose.p for pose in task.poses] + [arm.T_base_arm.p for arm in arms]
    for p in points:
        left, right = min(left, p[across]), max(right, p[across])
        bottom, top = min(bottom, p[up]), max(top, p[up])

    def pixels(x: float, y: float) -> tuple[float, float]:
        return (x - left) * _PIXELS_PER_M + _BORDER, (top - y) * _PIXELS_PER_M + _BORDER

    width, height = pixels(right, bottom)
    edge = sweep.region.spacing * _PIXELS_PER_M
    finite = [time for time in bound.values() if time < math.inf]
    fastest, slowest = min(finite), max(finite)
    parts = []
    for (x, y), time in bound.items():
        px, py = pixels(x, y)
        fill = _NONE if time == math.inf else _colour((time - fastest) / (slowest - fastest + 1e-9))
        parts.append(
            f'<rect x="{px - edge / 2:.1f}" y="{py - edge / 2:.1f}" width="{edge:.1f}"'
            f' height="{edge:.1f}" fill="{fill}" stroke="white"/>'
        )
    for pose in task.poses:
        px, py = pixels(pose.p[across], pose.p[up])
        parts.append(f'<circle cx="{px:.1f}" cy="{py:.1f}" r="4" fill="#1c7ed6"/>')
    for arm in arms:
        px, py = pixels(arm.T_base_arm.p[across], arm.T_base_arm.p[up])
        parts.append(
            f'<rect x="{px - 9:.1f}" y="{py - 9:.1f}" width="18" height="18"/>'
            f'<text x="{px:.1f}" y="{py + 24:.1f}" text-anchor="middle" font-size="12">'
            f"{escape(arm.name)}</text>"
        )
    for number, base in reversed([*enumerate(placement.best, 1)]):
        place = sweep.region.place(base.lattice_index)
        px, py = pixels(place[across], place[up])
        ahead = sweep.region.base(base.lattice_index).R[:, 0]
        dx, dy = 24.0 * ahead[across], -24.0 * ahead[up]
        parts.append(
            f'<path d="M{px:.1f} {py:.1f}l{dx:.1f} {dy:.1f}" stroke="#c92a2a" stroke-width="3"/>'
            f'<circle cx="{px:.1f}" cy="{py:.1f}" r="9" fill="#c92a2a"/>'
            f'<text x="{px:.1f}" y="{py + 4:.1f}" fill="white" text-anchor="middle"'
            f' font-size="11">{number}</text>'
        )
    parts.append(
        f'<text x="{_BORDER:.0f}" y="{height + _BORDER - 12:.0f}" font-size="14">green'
        f" {fastest:.2f} s, yellow {slowest:.2f} s, grey: out of reach or blocked;"
        f" {'xyz'[across]} to the right, {'xyz'[up]} up</text>"
    )
    size = f'width="{max(width + _BORDER, 560):.0f}" height="{height + _BORDER:.0f}"'
    inner = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif">\n'
        f'<rect width="100%" height="100%" fill="white"/>\n{inner}\n</svg>\n'
    )


def _axes(sweep: PlaceSweep) -> tuple[int, int]:
    region = sweep.region
    if region.mount != "wall":
        return 0, 1
    return (1 if region.x[0] == region.x[1] else 0), 2


def _colour(share: float) -> str:
    r, g, b = (round(a + share * (z - a)) for a, z in zip(_GOOD, _BAD, strict=True))
    return f"#{r:02x}{g:02x}{b:02x}"
