"""Grips on soft and hard things: a steady force, and a servo that stays cool for ten minutes."""

import pytest
from harness.emulated_rig import hardware_bench

from so101_motion.drivers.feetech.servo_judgement import WARM_C
from so101_motion.drivers.servo_types import STS3215_7V4, STS3215_12V

FOAM, WOOD = 5.0, 600.0  # [N m/rad at the jaw], chosen


def opened(bench):
    rig = bench.open()
    bench.advance(0.5)
    bench.finish(rig.gripper.move(0.8, wait=False))
    return rig


@pytest.mark.parametrize(
    ("stiffness", "kind"),
    [(FOAM, STS3215_12V), (WOOD, STS3215_7V4)],
    ids=["foam, 12 V", "wood, 7.4 V"],
)
def test_a_grip_is_steady_and_stays_cool(tmp_path, stiffness, kind):
    with hardware_bench(tmp_path, reply_timeout=2.0, kind=kind) as bench:
        rig = opened(bench)
        bench.world.put_object(0.03, stiffness)
        bench.finish(rig.gripper.grab(wait=False))
        bench.advance(1.0)
        drive = bench.world.servo("gripper").drive
        forces = []
        for _ in range(20):
            bench.advance(0.1)
            forces.append(drive.duty)
        assert rig.gripper.is_holding
        assert rig.last_failure is None
        assert max(forces) - min(forces) < 0.01
        assert 0.05 < abs(forces[-1]) < 0.25
        drive.motor.advance(600.0, duty=drive.duty, volts=drive.volts, velocity=0.0)
        assert drive.motor.temperature < WARM_C - 5.0
