"""The simulated arm over gRPC: moves, stops, manual mode, requests, geometries, configuration."""

import asyncio
import json
import math

import numpy as np
import pytest
from grpclib import GRPCError, Status
from harness.fake_parent import FakeMotion, until
from harness.in_process_module import (
    advance,
    duration_of,
    guarded_arm,
    in_time,
    joints,
    new_arm,
    positions,
    refused,
)
from viam.components.arm import KinematicsFileFormat, MoveOptions, Pose
from viam.services.motion import Motion

HOME = [0.0, -45.0, 45.0, 60.0, 0.0]
ELSEWHERE = [30.0, -30.0, 30.0, 40.0, 20.0]
ATTRIBUTES = {"acceleration_degs_per_sec_per_sec": 500.0}


async def start(client, call):
    """``call`` under way: planned, and visibly moving."""
    task = asyncio.ensure_future(call)
    begin = await positions(client)
    while np.max(np.abs(np.subtract(await positions(client), begin))) < 0.5:
        assert not task.done(), await task
        await advance(client, 0.02)
    return task


async def test_what_cannot_be_is_refused_and_moves_nothing(client):
    above = Pose(x=250, y=0, z=150, o_z=1)

    def to(**extra):
        return client.move_to_joint_positions(joints(*HOME), extra=extra)

    def through(**extra):
        return client.move_through_joint_positions([joints(*HOME)], extra=extra)

    for call, says in (
        (
            client.move_to_position(above, extra={"goal_metric_type": "position_onli"}),
            'did you mean "position_only"',
        ),
        (client.move_to_position(Pose(x=0.25, y=0.1, z=0.15)), "did you mean metres"),
        (to(wait="no"), "wait"),
        (to(streamed="no"), "streamed"),
        (through(interpolate="no"), "interpolate"),
        (through(waitAtEnd="no"), "waitAtEnd"),
        (to(replan="yes"), "replan"),
        (to(replan=True, wait=False), "replan"),
        (through(replan=True), "replan"),
    ):
        await refused(call, Status.INVALID_ARGUMENT, says)
    await client.move_through_joint_positions([])
    assert not await client.is_moving()


async def test_a_motion_that_is_planned_again_goes_on_to_a_new_goal(client):
    replan = {"replan": True}
    await in_time(client, client.move_to_joint_positions(joints(*HOME), extra=replan))
    old = await start(client, client.move_to_joint_positions(joints(*ELSEWHERE), extra=replan))
    above = Pose(x=250, y=0, z=150, o_z=-1)
    await in_time(client, client.move_to_position(above, extra=replan))
    with pytest.raises(GRPCError, match="a newer motion"):
        await old
    reached = await client.get_end_position()
    assert (reached.x, reached.y, reached.z) == pytest.approx((250, 0, 150), abs=1.0)


async def test_an_arm_that_is_being_removed_begins_no_other_move():
    async with guarded_arm() as client:
        sweep = asyncio.ensure_future(client.move_to_joint_positions(joints(60, 0, 0, 0, 0)))
        await until(client.is_moving)
        await client.resource.removed()
        again = client.move_to_joint_positions(joints(*HOME))
        retarget = client.move_to_joint_positions(joints(*HOME), extra={"wait": False})
        for move in (sweep, again, retarget):
            await refused(move, Status.CANCELLED, "removal of its arm")
        assert not await client.is_moving()


# Manual mode, requests, geometries and configuration


async def test_the_motion_parameters_are_answered_in_both_styles(client):
    assert await client.do_command({"command": "get_motion_params"}) == {"speed_degs_per_sec": 90.0}
    assert await client.do_command({"get_motion_params": True}) == {
        "current_speed_degs_per_sec": 90.0,
        "current_acceleration_degs_per_sec_per_sec": 500.0,
    }
    request = {"set_speed": 60.0, "set_acceleration": 150.0, "get_motion_params": True}
    assert await client.do_command(request) == {
        "speed_set": 60.0,
        "acceleration_set": 150.0,
        "current_speed_degs_per_sec": 60.0,
        "current_acceleration_degs_per_sec_per_sec": 150.0,
    }


async def test_a_refused_request_has_changed_nothing(client):
    for request_, says in [
        ({"set_speed": 60.0, "set_acceleration": 5.0}, ("set_acceleration", "10", "500")),
        ({"set_speed": 2.9}, ("set_speed", "3", "180")),
        ({"set_speed": 60.0, "get_motion_params": 1.0}, ("get_motion_params", "true or false")),
        ({"set_speed": "fast"}, ("set_speed", "a number")),
        ({"command": "advance_time", "seconds": -1.0}, ("seconds",)),
        ({"command": "advance_time", "seconds": math.nan}, ("seconds",)),
        ({"command": "enter_manual_mode", "enabled_for": -1}, ("enabled_for",)),
        ({"set_speed": 60.0, "set_sped": 60.0}, ("set_sped", 'did you mean "set_speed"?')),
    ]:
        await refused(client.do_command(request_), Status.INVALID_ARGUMENT, *says)
        params = await client.do_command({"get_motion_params": True})
        assert params["current_speed_degs_per_sec"] == 90.0


async def test_geometries_and_models_go_together_and_follow_the_joints(client):
    await in_time(client, client.move_to_joint_positions(joints(*HOME)))
    before = {g.label: g.center for g in await client.get_geometries()}
    await in_time(client, client.move_to_joint_positions(joints(*ELSEWHERE)))
    after = {g.label: g.center for g in await client.get_geometries()}
    models = await client.get_3d_models()

    assert set(before) == {f"arm:{part}" for part in models}
    assert set(models) == {"base", "shoulder", "upper_arm", "lower_arm", "wrist"}
    assert after["arm:base"].x == pytest.approx(before["arm:base"].x)
    assert (
        math.hypot(
            after["arm:wrist"].x - before["arm:wrist"].x,
            after["arm:wrist"].y - before["arm:wrist"].y,
        )
        > 30.0
    )
    assert sum(len(mesh.mesh) for mesh in models.values()) < 2_000_000


async def test_it_tells_its_kinematics_what_it_can_do_and_its_status(client):
    kind, data, *_ = await client.get_kinematics()
    assert kind == KinematicsFileFormat.KINEMATICS_FILE_FORMAT_SVA
    assert json.loads(data)["name"] == "arm"

    properties = await client.get_properties()
    assert properties.support_manual_mode
    assert properties.support_cartesian_commands

    status = await client.get_status()
    assert status["mode"] == "auto"
    assert status["is_moving"] is False
    assert set(status["joint_positions_deg"]) >= {"shoulder_pan", "wrist_roll"}
    assert "fault" not in status, "absent, for a null would read as 0"


async def test_the_tool_is_marked_and_the_kinematics_are_urdf_when_asked_for():
    async with guarded_arm(visualize_ee_frame=True, use_urdf=True, simulate_time=False) as client:
        kind, data, *_ = await client.get_kinematics()
        models = await client.get_3d_models()
        labels = [geometry.label for geometry in await client.get_geometries()]
        await client.resource.close()  # as often as one likes
    assert kind == KinematicsFileFormat.KINEMATICS_FILE_FORMAT_URDF
    assert b"<robot" in data
    assert "tool" in models
    assert labels[-1] == "arm:tool"


async def test_a_named_motion_service_plans_instead():
    service = FakeMotion()
    named = {Motion.get_resource_name("mine"): service}
    async with guarded_arm(dependencies=named, motion="mine", simulate_time=False) as client:
        extra = {"max_ik_solutions": 5.0}
        await client.move_to_position(Pose(x=1, y=2, z=3, o_z=1), extra=extra)
        await client.move_to_position(Pose(x=1, o_z=1), extra={"goal_metric_type": "own"})
        service.answer = False
        await refused(client.move_to_position(Pose(x=1, o_z=1)), Status.ABORTED)
    component, destination, sent = service.calls[0]
    assert component == "arm"
    assert destination.reference_frame == "arm_origin"
    assert (destination.pose.x, destination.pose.y, destination.pose.z) == (1, 2, 3)
    assert sent == {"goal_metric_type": "position_only", "max_ik_solutions": 5.0}
    assert service.calls[1][2] == {"goal_metric_type": "own"}


async def test_attributes_of_another_model_are_ignored_and_named_in_the_log(caplog):
    await new_arm(port="/dev/ttyACM0", _comment="was the real one").close()
    assert "has no such attribute: _comment, port" in caplog.text


async def test_a_new_configuration_leaves_the_joints_where_they_are():
    async with guarded_arm(simulate_time=False) as client:
        await in_time(client, client.move_to_joint_positions(joints(*HOME)))
    async with (
        guarded_arm(simulate_time=False, floor_z_mm=-5.0) as client,
        guarded_arm(name="other") as elsewhere,
    ):
        assert await positions(client) == pytest.approx(HOME, abs=0.01)
        assert await positions(elsewhere) == pytest.approx([0.0] * 5)


async def test_no_request_exceeds_the_arm_s_largest_speed():
    async with guarded_arm(simulate_time=False, max_speed_degs_per_sec=20.0) as client:
        await refused(
            client.do_command({"set_speed": 21.0}),
            Status.INVALID_ARGUMENT,
            "max_speed_degs_per_sec, 20 deg/s",
        )
        await in_time(client, client.move_to_joint_positions(joints(*HOME)))
        for pan, options in (
            (60.0, MoveOptions(max_vel_degs_per_sec=180.0, max_acc_degs_per_sec2=500.0)),
            (0.0, MoveOptions(max_vel_degs_per_sec_joints=[180.0] * 5)),
        ):
            there = client.move_through_joint_positions([joints(pan, *HOME[1:])], options)
            assert await duration_of(client, there) > 60.0 / 20.0
        at_once = client.move_to_joint_positions(joints(*ELSEWHERE), extra={"wait": False})
        await at_once
        before = list((await client.get_joint_positions()).values)
        await advance(client, 0.5)
        after = list((await client.get_joint_positions()).values)
        assert max(abs(b - a) for a, b in zip(before, after, strict=True)) <= 10.0 + 1e-6
