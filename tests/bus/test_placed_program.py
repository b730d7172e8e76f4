"""The programs of the best bases for a task run on emulated servos with weight and friction."""

import math

import numpy as np

from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.program import Solo, files, rehearse, start_program
from so101_motion.tasks.sweeps import (
    PlaceSweep,
    Region,
    find_bases,
    task_text,
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
        arms = Solo.of(rig)
        run = start_program(arms, rehearse(arms, program))
        bench.finish(run)
        bench.advance(0.5)
        q = np.array([math.radians(each) for each in bench.arm_deg(rig)])
        p = REGION.base(base.lattice_index) @ model.frame(q, "jaw_tip").p
        assert np.linalg.norm(p - TASK.poses[-1].p) < 0.01
