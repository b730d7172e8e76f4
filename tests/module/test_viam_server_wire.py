"""Requests mean the same after viam-server has changed them on their way to us."""

import asyncio

import numpy as np
import pytest
from grpclib import GRPCError
from grpclib.testing import ChannelFor
from harness.fake_parent import config_of
from harness.in_process_module import arm_client, in_time, new_arm
from harness.viam_server_wire import sent_on
from viam.components.arm import JointPositions
from viam.proto.common import GeometriesInFrame, Geometry, Mesh, Pose, PoseInFrame, WorldState
from viam.proto.common import PointCloud as ViamCloud
from viam.resource.manager import ResourceManager
from viam.services.motion import MotionClient
from viam.services.motion.service import MotionRPCService

from so101_motion.planning.collision.scene import PointCloud, Scene
from so101_motion.planning.collision.shape_files import read_shape
from so101_motion.viam.conversion.frames import Frames
from so101_motion.viam.conversion.world_state import scene_with
from so101_motion.viam.conversion.world_state_json import pcd
from so101_motion.viam.models.motion_service import So101Motion

CUBE_AT_MM = np.array([230.0, 50.0, 140.0])
NO_CENTRE, AT_ORIGIN = None, Pose(o_z=1.0)
MIDDLE = Pose(x=230.0, y=50.0, z=140.0, o_z=1.0)


def cube_points(around_mm):
    """A cube of 60 mm of points, 10 mm apart, shape (n, 3), [m]."""
    edge = np.arange(-30.0, 31.0, 10.0)
    grid = np.stack(np.meshgrid(edge, edge, edge, indexing="ij"), axis=-1).reshape(-1, 3)
    return (grid + around_mm) / 1000.0


def cloud(around_mm, center):
    data = pcd(PointCloud(points=cube_points(around_mm)))
    return world(Geometry(label="seen", center=center, pointcloud=ViamCloud(point_cloud=data)))


def world(geometry):
    return WorldState(
        obstacles=[GeometriesInFrame(reference_frame="arm_origin", geometries=[geometry])]
    )


DIRECT = {
    "points where they are, no centre": cloud(CUBE_AT_MM, NO_CENTRE),
    "points where they are, a centre of nothing": cloud(CUBE_AT_MM, AT_ORIGIN),
    "points around their centre": cloud(0.0, MIDDLE),
    "points where they are, their middle as centre": cloud(CUBE_AT_MM, MIDDLE),
}
THROUGH_VIAM_SERVER = {
    "points where they are, through viam-server": sent_on(cloud(CUBE_AT_MM, AT_ORIGIN)),
    "points and middle, through viam-server": sent_on(cloud(CUBE_AT_MM, MIDDLE)),
}
CLOUDS = DIRECT | THROUGH_VIAM_SERVER


async def obstacle_points(request):
    frames = Frames("arm", None)
    (obstacle,) = (await scene_with(Scene(), request, frames)).obstacles
    T = obstacle.T_base_obstacle
    return read_shape(obstacle.shape).points @ T.R.T + T.p


@pytest.mark.parametrize("request_world", CLOUDS.values(), ids=CLOUDS)
async def test_a_cloud_stands_where_its_points_are(request_world):
    points = await obstacle_points(request_world)
    np.testing.assert_allclose(points, cube_points(CUBE_AT_MM), atol=1e-6)


async def test_a_turned_centre_turns_the_points():
    turned = Pose(x=230.0, y=50.0, z=140.0, o_z=1.0, theta=90.0)
    points = await obstacle_points(cloud(np.array([10.0, 0.0, 0.0]), turned))
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    np.testing.assert_allclose(middle, (0.230, 0.060, 0.140), atol=1e-6)


@pytest.mark.parametrize("kind", ["stl", "ply", "stl_ascii"])
async def test_a_mesh_is_what_its_content_is(kind):
    import trimesh

    data = trimesh.creation.box((0.1, 0.2, 0.3)).export(file_type=kind)
    data = data.encode() if isinstance(data, str) else data
    mesh = Geometry(label="part", center=MIDDLE, mesh=Mesh(content_type="stl", mesh=data))
    (part,) = (await scene_with(Scene(), sent_on(world(mesh)), Frames("arm", None))).obstacles
    np.testing.assert_allclose(
        np.ptp(read_shape(part.shape).vertices, axis=0), (0.1, 0.2, 0.3), atol=1e-6
    )
    np.testing.assert_allclose(part.T_base_obstacle.p, CUBE_AT_MM / 1000)


@pytest.fixture
async def arm():
    resource = new_arm(simulate_time=False, acceleration_degs_per_sec_per_sec=500.0)
    async with arm_client(resource) as client:
        ready = JointPositions(values=[0.0, -45.0, 45.0, 60.0, 0.0])
        await in_time(client, client.move_to_joint_positions(ready))
        yield client
    await resource.close()


@pytest.fixture
async def motion(arm):
    config = config_of("rdk:service:motion", "devrel:so101:motion", {}, "planner")
    service = So101Motion.new(config, {})
    async with ChannelFor([MotionRPCService(ResourceManager([service]))]) as channel:
        yield MotionClient(service.name, channel)


async def test_the_arm_does_not_drive_into_a_cloud(motion):
    into = PoseInFrame(reference_frame="arm_origin", pose=MIDDLE)
    with pytest.raises(GRPCError, match="seen"):
        async with asyncio.timeout(30.0):
            await motion.move("arm", into, sent_on(cloud(CUBE_AT_MM, MIDDLE)))
