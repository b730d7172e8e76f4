"""Pick and place on emulated servos: what the arm believes, beside where the thing truly is."""

import numpy as np
import pytest
from harness.emulated_rig import MIDDLES_DEG, hardware_bench, rad
from harness.things_around import UP, around, cube

from so101_motion.common.errors import MotionError
from so101_motion.common.state import ARM_JOINTS
from so101_motion.rig.things import things_in

ZEROS = dict(zip(ARM_JOINTS, np.radians(MIDDLES_DEG), strict=True))


def test_it_lies_where_it_was_put_and_a_loss_on_the_way_is_told(tmp_path, planning_process):
    start = (*UP.tolist(), 0.0)
    with hardware_bench(tmp_path, reply_timeout=2.0, q_start=start) as bench:
        things = bench.world.things = things_in(around(cube()))
        rig = bench.open(zero_offsets=ZEROS)
        rig.arm.set_speed(rad(120.0))
        rig.arm.scene = around(cube())
        bench.advance(0.5)
        bench.finish(rig.pick("cube", wait=False), at_most=60.0)
        assert things.held == "cube"
        bench.finish(rig.place("cube", at=(0.15, 0.15, 0.0), wait=False), at_most=60.0)
        true, believed = things.where("cube"), rig.arm.scene.items[0].T_base_obstacle
        assert things.held is None
        assert true.p == pytest.approx(believed.p, abs=3e-3)
        assert true.p[:2] == pytest.approx([0.15, 0.15], abs=5e-3)

        bench.finish(rig.pick("cube", wait=False), at_most=60.0)
        run = rig.place("cube", at=(0.15, -0.15, 0.0), wait=False)
        while run.stage != "carry":
            bench.advance(0.05)
        bench.advance(0.2)
        things.take_away("cube")
        with pytest.raises(MotionError, match="the grip on 'cube' was lost while carrying"):
            bench.finish(run, at_most=60.0)
        assert not rig.arm.scene.items
