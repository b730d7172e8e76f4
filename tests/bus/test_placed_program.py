"""The programs of the best bases for a task run on emulated servos with weight and friction."""

import math
from dataclasses import replace

import numpy as np
import pytest
from harness.emulated_pair import Arm
from harness.emulated_rig import hardware_bench

from so101_motion.arm.cell import Cell
from so101_motion.common.clock import ManualClock
from so101_motion.files.cell_file import read_cell
from so101_motion.planning.collision.apart import are_apart
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.program import files, rehearse, start_program
from so101_motion.tasks.sweeps import (
    PlaceSweep,
    Region,
    find_bases,
    find_pairs,
    task_text,
    write_pairs,
    write_placement,
)
from so101_motion.tasks.sweeps.placement_task import task_from

DOWN = {"approach": [0, 0, -1], "approach_tolerance_deg": 15}
TASK = task_from(
    {
        "frame": "jaw_tip",
        "poses": [
            {"name": "left", "position_mm": [210, 40, 60], **DOWN},
            {"name": "right", "position_mm": [210, -40, 60], **DOWN},
        ],
    }
)
REGION = Region(x=(-0.04, 0.04), y=(0.0, 0.0), turn=(0.0, 0.0), spacing=0.04)


@pytest.fixture
def bench(tmp_path, planning_process):
    with hardware_bench(tmp_path) as bench:
        yield bench


def test_the_best_run_and_come_where_they_should(bench, tmp_path):
    sweep = PlaceSweep(task=task_text(TASK), region=REGION)
    placement = find_bases(sweep, tmp_path / "out")
    write_placement(placement, sweep, tmp_path / "out")
    rig, model = bench.open(), RobotModel.load()
    rig.arm.set_speed(np.radians(180.0))
    rig.arm.set_acceleration(np.radians(500.0))
    bench.advance(1.0)
    assert len(placement.best) >= 2
    for number, base in [*enumerate(placement.best, 1)][:2]:
        program = files.read(tmp_path / "out" / "best" / f"{number:02d}.json").with_rounds(1)
        run = start_program(
            rig.arm, rig.gripper, rig.clock, rehearse(rig.arm, rig.gripper, program)
        )
        bench.finish(run)
        bench.advance(0.5)
        q = np.array([math.radians(each) for each in bench.arm_deg(rig)])
        p = REGION.base(base.lattice_index) @ model.frame(q, "jaw_tip").p
        assert np.linalg.norm(p - TASK.poses[-1].p) < 0.01


def shifted(y):
    """The same task for an arm beside the other, and where its base may be."""
    poses = tuple(replace(pose, p=pose.p + np.array([0.0, y, 0.0])) for pose in TASK.poses)
    region = Region(x=(0.0, 0.0), y=(y, y), turn=(0.0, 0.0))
    return PlaceSweep(task=task_text(replace(TASK, poses=poses)), region=region)


def test_two_arms_do_their_work_side_by_side(tmp_path, planning_process):
    """In a cell that refuses or holds up an arm that comes near the other."""
    names, sweeps = ("left", "right"), (shifted(0.13), shifted(-0.13))
    out, clock, bodies = tmp_path / "out", ManualClock(), bodies_of()
    write_pairs(find_pairs(sweeps, out), sweeps, out, names)
    cell, file, arms = Cell(), read_cell(out / "best" / "01-cell.json"), []
    try:
        for place in file.arms:
            arms.append(Arm(tmp_path, place.name, clock, 2.0))
            clock.advance(0.004)
            cell.add(place.name, arms[-1].rig, place.T_cell_base)
        clock.advance(1.0)
        runs = []
        for name, arm in zip(names, arms, strict=True):
            program = files.read(out / "best" / f"01-{name}.json").with_rounds(1)
            planned = rehearse(arm.rig.arm, arm.rig.gripper, program)
            runs.append(start_program(arm.rig.arm, arm.rig.gripper, clock, planned))
        T = file.arms[0].T_cell_base.inverse @ file.arms[1].T_cell_base
        while not all(run.future.done() for run in runs):
            clock.advance(0.05)
            q = [np.radians(arm.q_deg)[None].copy() for arm in arms]
            assert are_apart(bodies, bodies, T, *q, room=0.01)
        for run in runs:
            run.future.result()
    finally:
        for arm in arms:
            arm.close()
