"""An object is passed from hand to hand by a request to the module's own process."""

import numpy as np
import pytest
from grpclib import GRPCError
from harness.emulated_port import in_the_end
from harness.fake_machine import FakeMachine, hanging
from harness.fake_parent import ARM, MOTION, SIMULATED, running_module
from viam.components.arm import JointPositions

ASIDE = [60.0, -30.0, 30.0, 30.0, 0.0]
STICK = {"name": "stick", "box_mm": [20, 20, 160], "position_mm": [0, 0, 150], "mass_kg": 0.04}


async def test_an_object_is_passed_on_and_then_the_other_arm_holds_it():
    async with running_module() as (module, _, _):
        quick = {"speed_degs_per_sec": 180, "acceleration_degs_per_sec_per_sec": 500}
        aside, arms = JointPositions(values=ASIDE), {}
        for name in ("left", "right"):
            arms[name] = arm = await module.add(ARM, SIMULATED, quick, name)
            await in_the_end(lambda arm=arm: arm.move_to_joint_positions(aside))
        module.parent.machine = FakeMachine(
            hanging("left", joints=5), hanging("right", x=350.0, theta=180.0, joints=5)
        )
        motion = await module.add(MOTION, "devrel:so101:motion", {}, "planner")
        assert (await motion.do_command({"holds": {"left": [STICK]}}))["holds"]

        request = {"handover": {"from": "left", "to": "right", "object": "stick"}}
        taken = (await in_the_end(lambda: motion.do_command(request)))["handover"]
        assert (taken["name"], taken["mass_kg"]) == ("stick", 0.04)
        nothing = {"handover": {"from": "left", "to": "right", "object": "stick"}}
        with pytest.raises(GRPCError, match="left, which holds: nothing"):
            await motion.do_command(nothing)
        another = {"handover": {"from": "right", "to": "left", "object": "another"}}
        with pytest.raises(GRPCError, match="right, which holds: stick"):
            await motion.do_command(another)
        for arm in arms.values():
            reached = (await arm.get_joint_positions()).values
            assert np.abs(np.subtract(reached, ASIDE)).max() > 5.0
