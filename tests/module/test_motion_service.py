"""The motion service over gRPC, with a simulated arm on a clock the test drives."""

import asyncio
import json
from contextlib import asynccontextmanager

import numpy as np
import pytest
from grpclib import GRPCError, Status
from harness.fake_machine import FakeMachine, Thing, hanging
from harness.fake_parent import config_of, until
from harness.in_process_module import advance, client_of, guarded_arm, in_time, new_arm, refused
from viam.components.arm import JointPositions
from viam.proto.common import (
    GeometriesInFrame,
    Geometry,
    Pose,
    PoseInFrame,
    RectangularPrism,
    Vector3,
    WorldState,
)
from viam.proto.common import PoseCloud as GoalCloud
from viam.proto.service.motion import (
    CollisionSpecification,
    Constraints,
    LinearConstraint,
    PseudolinearConstraint,
)

from so101_motion.common.geometry import SE3, rotation_by
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.frames import set_machine
from so101_motion.viam.models.motion_service import So101Motion

MOTION = "rdk:service:motion"
READY = [0.0, -45.0, 45.0, 60.0, 0.0]


def machine_with_gripper():
    """The arm stands on the world's origin; a gripper's frame is 60 mm ahead of the tool."""
    machine = FakeMachine(
        hanging("arm", joints=5),
        hanging("gripper", "arm", z=60.0),
        hanging("camera"),
        things=[Thing("gripper"), Thing("camera")],
    )
    machine.ends["arm"] = SE3.identity()  # its joints do not matter for what is asked here
    return machine


@pytest.fixture
async def arm():
    async with guarded_arm(simulate_time=False, acceleration_degs_per_sec_per_sec=500.0) as client:
        await in_time(client, client.move_to_joint_positions(JointPositions(values=READY)))
        yield client


@pytest.fixture
async def motion(arm):
    machine = machine_with_gripper()
    set_machine(lambda: machine)
    service = So101Motion.new(config_of(MOTION, "devrel:so101:motion", {}, "planner"), {})
    async with client_of(service) as client:
        yield client
    set_machine(lambda: None)


def at(x, y, z, frame="world", **orientation):
    return PoseInFrame(
        reference_frame=frame, pose=Pose(x=x, y=y, z=z, **(orientation or {"o_z": 1}))
    )


def box(name, size, x, y, z):
    dims = Vector3(x=size[0], y=size[1], z=size[2])
    return Geometry(
        label=name, box=RectangularPrism(dims_mm=dims), center=Pose(x=x, y=y, z=z, o_z=1)
    )


def around(*geometries):
    return WorldState(
        obstacles=[GeometriesInFrame(reference_frame="world", geometries=list(geometries))]
    )


WALL = around(box("wall", (20, 120, 300), 230, 0, 150))
"""Between the two sides of the arm, reaching far out."""


STRAIGHT = Constraints(linear_constraint=[LinearConstraint(line_tolerance_mm=1)])


async def tool(arm):
    pose = await arm.get_end_position()
    return np.array([pose.x, pose.y, pose.z])


async def test_the_gripper_may_be_named_instead_of_the_arm(arm, motion):
    assert await in_time(arm, motion.move("gripper", at(240, 60, 100)))
    T = arm.resource.rig.arm.T_base()
    np.testing.assert_allclose(1000 * T.p + 60 * T.R[:, 2], (240, 60, 100), atol=0.2)


async def test_the_path_avoids_the_obstacles_of_the_request(arm, motion):
    await in_time(arm, motion.move("arm", at(200, -140, 120)))
    await in_time(arm, motion.move("arm", at(200, 140, 120), WALL))
    np.testing.assert_allclose(await tool(arm), (200, 140, 120), atol=0.2)
    request, plan = arm.resource.rig.arm.newest
    assert [o.name for o in request.scene.obstacles] == ["wall"]
    assert not plan.report.straight

    # They are those of that request alone.
    with pytest.raises(GRPCError, match="wall"):
        await motion.move("arm", at(230, 0, 150), WALL)
    assert await in_time(arm, motion.move("arm", at(230, 0, 150)))


async def test_a_move_is_replanned_when_asked_for_and_alone(arm, motion):
    extra = {"replan": True}
    assert await in_time(arm, motion.move("arm", at(220, -50, 100), extra=extra))
    with pytest.raises(GRPCError, match="cannot be combined with world_state, constraints"):
        await motion.move("arm", at(220, 50, 100), constraints=STRAIGHT, extra=extra)


@pytest.mark.parametrize(
    ("constraints", "within"),
    [
        (STRAIGHT, 1e-3),
        (
            Constraints(
                pseudolinear_constraint=[PseudolinearConstraint(line_tolerance_factor=0.05)]
            ),
            5e-3,  # of a way of 100 mm
        ),
    ],
)
async def test_a_line_is_kept_when_asked_for(arm, motion, constraints, within):
    await in_time(arm, motion.move("arm", at(220, -50, 100)))
    assert await in_time(arm, motion.move("arm", at(220, 50, 100), constraints=constraints))
    path = arm.resource.rig.arm.newest[1].tool_path
    assert np.abs(path[:, [0, 2]] - (0.22, 0.1)).max() < within


async def test_a_line_ends_in_the_cloud_that_its_destination_has(arm, motion):
    await in_time(arm, motion.move("arm", at(200, 0, 100)))
    here = arm.resource.rig.arm.T_base()
    nodded = SE3(rotation_by([0.0, 0.3, 0.0]) @ here.R, here.p + np.array([0.02, 0.0, 0.02]))
    wanted = PoseInFrame(reference_frame="world", pose=convert.to_pose(nodded))
    wanted.goal_cloud.CopyFrom(GoalCloud(o_x=0.02, o_y=0.02, o_z=0.02, theta=180))
    assert await in_time(arm, motion.move("arm", wanted, constraints=STRAIGHT))
    there = arm.resource.rig.arm.T_base()
    np.testing.assert_allclose(there.R[:, 2], nodded.R[:, 2], atol=0.03)

    aside = PoseInFrame(reference_frame="world", pose=convert.to_pose(there))
    aside.pose.y += 80.0
    aside.goal_cloud.CopyFrom(GoalCloud(o_x=0.02, o_y=0.02, o_z=0.02, theta=180))
    with pytest.raises(GRPCError, match="outside its cloud; widen the tolerances"):
        await motion.move("arm", aside, constraints=STRAIGHT)
    aside.goal_cloud.CopyFrom(GoalCloud(o_x=1, o_y=1, o_z=2, theta=180))
    assert await in_time(arm, motion.move("arm", aside, constraints=STRAIGHT))


async def test_contacts_can_be_allowed_by_name(arm, motion):
    crate = around(box("crate", (60, 60, 60), 250, 0, 30))
    with pytest.raises(GRPCError, match="crate"):
        await motion.move("arm", at(250, 0, 60), crate)
    allow = CollisionSpecification.AllowedFrameCollisions(frame1="arm", frame2="crate")
    allowed = Constraints(collision_specification=[CollisionSpecification(allows=[allow])])
    assert await in_time(arm, motion.move("arm", at(250, 0, 60), crate, allowed))


async def test_giving_up_the_call_stops_the_arm(arm, motion):
    call = asyncio.ensure_future(motion.move("arm", at(100, -200, 150)))
    await until(lambda: arm.resource.rig.arm.state.arm_moving)
    await advance(arm, 0.1)
    call.cancel()
    with pytest.raises(asyncio.CancelledError):
        await call
    await until(lambda: arm.resource.rig.arm.newest_motion.future.done())
    assert not arm.resource.rig.arm.state.arm_moving
    assert np.linalg.norm(await tool(arm) - (100, -200, 150)) > 10


async def test_a_plan_can_be_asked_for_looked_at_and_executed(arm, motion):
    request = json.dumps(
        {
            "componentName": "arm",
            "destination": {
                "referenceFrame": "world",
                "pose": {"x": 220, "y": 90, "z": 120, "oZ": 1},
            },
        }
    )
    before = await tool(arm)
    told = (await motion.do_command({"preview": request}))["preview"]
    np.testing.assert_allclose(told["tool_path_mm"][-1], (220, 90, 120), atol=0.2)
    assert (told["waits_s"], told["waits_for"]) == (0.0, [])
    np.testing.assert_allclose(await tool(arm), before, atol=0.01)  # it may be settling still
    steps = (await motion.do_command({"plan": request}))["plan"]
    with pytest.raises(GRPCError, match="is not the arm of this service, arm"):
        await motion.do_command({"execute": [{"left": [0.0] * 5}]})
    assert (await in_time(arm, motion.do_command({"execute": steps})))["execute"]
    np.testing.assert_allclose(await tool(arm), (220, 90, 120), atol=0.5)
    pose = (await motion.get_pose("arm", "world")).pose
    np.testing.assert_allclose((pose.x, pose.y, pose.z), await tool(arm), atol=1e-6)


@asynccontextmanager
async def two_arms(**attributes):
    """A gripper hangs from the arm "arm"; beside it stands another, "left"."""
    machine = machine_with_gripper()
    machine.configs.append(hanging("left", y=900.0, joints=5))
    set_machine(lambda: machine)
    arms = [new_arm(name=name) for name in ("arm", "left")]
    config = config_of(MOTION, "devrel:so101:motion", attributes, "planner")
    try:
        async with client_of(So101Motion.new(config, {})) as client:
            yield client
    finally:
        for arm in arms:
            await arm.close()
        set_machine(lambda: None)


STICK = {"name": "stick", "box_mm": [20, 20, 160], "position_mm": [0, 0, 150], "mass_kg": 0.04}


def to_there(component):
    pose = {"x": 220, "y": 60, "z": 120, "oZ": 1}
    destination = {"referenceFrame": "arm_origin", "pose": pose}
    return {"preview": {"componentName": component, "destination": destination}}


async def test_of_several_arms_the_one_moves_that_the_component_hangs_from():
    async with two_arms() as motion:
        told = (await motion.do_command(to_there("gripper")))["preview"]
        assert list(told["plan"][0]) == ["arm"]
        await refused(
            motion.do_command(to_there("camera")),
            None,
            "is not attached to an arm of this module",
            "arm, left",
        )
        assert await motion.get_status() == {"arms": ["arm", "left"]}

        assert (await motion.do_command({"holds": {"left": [STICK]}}))["holds"]
        for giver, taker, thing, holds in (
            ("arm", "left", "stick", "nothing"),
            ("left", "arm", "cup", "stick"),
        ):
            request = {"handover": {"from": giver, "to": taker, "object": thing}}
            await refused(motion.do_command(request), None, f"{giver}, which holds: {holds}")


async def test_an_arm_that_the_configuration_misspells_is_named():
    async with two_arms(arm="lfet") as motion:
        with pytest.raises(GRPCError, match=r"lfet.*did you mean .left"):
            await motion.move("arm", at(220, 60, 120, "arm_origin"))
        assert "lfet" in (await motion.get_status())["problem"]


async def test_requests_for_mobile_bases_are_refused_as_such(motion):
    await refused(motion.stop_plan("arm"), Status.UNIMPLEMENTED)
