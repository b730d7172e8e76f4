"""The world-state store over gRPC: the scene an arm plans with, shown in Viam's 3D view."""

import asyncio

import numpy as np
import pytest
from grpclib import GRPCError, Status
from harness.fake_parent import config_of
from harness.in_process_module import client_of, new_arm, refused
from viam.proto.service.worldstatestore import StreamTransformChangesResponse

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import (
    Attached,
    Box,
    Capsule,
    Mesh,
    Obstacle,
    PointCloud,
    Scene,
    Sphere,
)
from so101_motion.planning.goals import PoseGoal
from so101_motion.viam.models.world_state_store import So101WorldState

STORE = "rdk:service:world_state_store"


@pytest.fixture
async def arm():
    resource = new_arm(simulate_time=False)
    yield resource.rig.arm
    await resource.close()


@pytest.fixture
async def store(arm):
    service = So101WorldState.new(config_of(STORE, "devrel:so101:world-state", {}, "world"), {})
    async with client_of(service) as client:
        yield client


async def everything(store):
    return {
        t.reference_frame: t
        for t in [await store.get_transform(u) for u in await store.list_uuids()]
    }


def scene():
    at = SE3.from_translation((0.3, 0.1, 0.05))
    triangle = Mesh(vertices=[[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], triangles=[[0, 1, 2]])
    return Scene(
        obstacles=(
            Obstacle(name="box", shape=Box(size=(0.1, 0.2, 0.3)), T_base_obstacle=at),
            Obstacle(name="post", shape=Capsule(radius=0.01, length=0.1), T_base_obstacle=at),
            Obstacle(name="plate", shape=triangle, T_base_obstacle=at),
            Obstacle(name="seen", shape=PointCloud(points=[[0, 0, 0.5]]), T_base_obstacle=at),
            Obstacle(name="zone", shape=Sphere(radius=0.05), T_base_obstacle=at, keep_out=True),
        ),
        attached=(
            Attached(
                name="cube",
                shape=Box(size=(0.02, 0.02, 0.02)),
                T_tool_object=SE3.from_translation((0, 0, 0.1)),
            ),
        ),
    )


async def test_obstacles_and_held_objects_are_shown_where_they_are(arm, store):
    arm.scene = scene()
    shown = await everything(store)
    assert set(shown) == {"box", "post", "plate", "seen", "zone", "cube", "arm floor"}
    assert all(thing.physical_object.HasField("center") for thing in shown.values())
    assert shown["box"].physical_object.box.dims_mm.z == pytest.approx(300)
    assert shown["box"].pose_in_observer_frame.reference_frame == "arm_origin"
    assert shown["box"].pose_in_observer_frame.pose.x == pytest.approx(300)
    assert shown["cube"].pose_in_observer_frame.reference_frame == "arm"
    assert shown["zone"].metadata["opacity"] < shown["box"].metadata["opacity"]


async def test_the_newest_plan_is_shown_with_its_goal(arm, store):
    plan = await asyncio.to_thread(arm.plan, PoseGoal.at_point((0.2, 0.1, 0.12)))
    shown = await everything(store)
    goal = shown["arm goal"].pose_in_observer_frame.pose
    np.testing.assert_allclose((goal.x, goal.y, goal.z), 1000 * plan.tool_path[-1], atol=1e-6)
    assert sum("arm path" in name for name in shown) > 20


async def test_a_stream_reports_added_changed_and_removed_objects(arm, store):
    changes = store.stream_transform_changes()
    arm.scene = Scene(obstacles=scene().obstacles[:1])
    # viam-server drops the first message, and waits for it before it answers its own client.
    assert await anext(changes) == StreamTransformChangesResponse()
    assert (await anext(changes)).transform.reference_frame == "arm floor"
    added = await anext(changes)
    assert (added.change_type, added.transform.reference_frame) == (1, "box")
    moved = Obstacle(
        name="box",
        shape=Box(size=(0.1, 0.2, 0.3)),
        T_base_obstacle=SE3.from_translation((0.4, 0, 0)),
    )
    arm.scene = Scene(obstacles=(moved,))
    updated = await anext(changes)
    assert updated.change_type == 3
    assert list(updated.updated_fields.paths) == ["pose_in_observer_frame"]
    arm.scene = Scene()
    gone = await anext(changes)
    assert (gone.change_type, gone.transform.uuid) == (2, added.transform.uuid)
    with pytest.raises(GRPCError, match="no transform of this UUID"):
        await store.get_transform(gone.transform.uuid)
    await changes.aclose()


async def test_there_is_always_something_to_show(store):
    """viam-server takes an empty list for a failure: nil response."""
    (floor,) = (await everything(store)).values()
    assert floor.reference_frame == "arm floor"
    top_mm = floor.pose_in_observer_frame.pose.z + floor.physical_object.box.dims_mm.z / 2
    assert top_mm == pytest.approx(-2.4)


async def test_a_request_is_refused_with_what_answers_instead(store):
    await refused(
        store.do_command({"command": "list"}),
        Status.UNIMPLEMENTED,
        "has no commands; use ListUUIDs",
    )
    assert await store.get_status() == {"arms": ["arm"]}
