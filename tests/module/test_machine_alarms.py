"""An arm of a running machine, with a joint outside its range: what is told, and what moves it."""

import time
from dataclasses import replace

import numpy as np
import pytest
from harness.fake_parent import ARM, HARDWARE_ARM
from harness.viam_machine import carried_out, running_machine

from so101_motion.calib.record import record, store
from so101_motion.common.units import to_rad
from so101_motion.planning.goals import JointGoal
from so101_motion.viam.client import MachineRig

OUTSIDE = 100  # [tick] that the wrist's roll is outside its range


def calibration_with_the_roll_outside(path):
    entries = {
        joint: replace(record.default(joint), id=i)
        for i, joint in enumerate(record.JOINTS, start=1)
    }
    aside = 2048 + OUTSIDE  # the hand holds it at 2048
    store.save(path, entries | {"wrist_roll": replace(entries["wrist_roll"], range_min=aside)})
    return str(path)


def test_the_next_motion_of_a_machines_arm_brings_a_joint_in_as_the_alarm_says(tmp_path):
    file = calibration_with_the_roll_outside(tmp_path / "calibration.json")
    with running_machine(emulated=True) as machine:
        machine.remove(ARM, "arm")
        attributes = {"port": machine.port, "calibration_file": file}
        arm = machine.add(ARM, HARDWARE_ARM, "arm", attributes)
        assert machine.do(arm, "write_calibration")["success"]
        with MachineRig.connect(machine.address, arm="arm") as rig:
            for _ in range(100):  # the arm is opened after the file was stored
                rig.refresh()
                if rig.state.reading.out_of_range:
                    break
                time.sleep(0.1)
            ((joint, limit),) = rig.state.reading.out_of_range.items()
            assert joint == "wrist_roll"
            assert limit - rig.state.q[4] == pytest.approx(to_rad(OUTSIDE * 360 / 4096), abs=0.02)
            goal = rig.state.q + np.radians([12.0, -9.0, 15.0, 6.0, 20.0])
            carried_out(lambda: rig.arm.move(JointGoal(q=goal), wait=False).result(60.0))
            rig.refresh()
            assert rig.state.reading.out_of_range == {}
            assert rig.state.q == pytest.approx(goal, abs=to_rad(2.0))
