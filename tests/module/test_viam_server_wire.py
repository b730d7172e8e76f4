"""A cloud means the same after viam-server has changed it on its way to us."""

import numpy as np
import pytest
from viam.proto.common import GeometriesInFrame, Geometry, Pose, WorldState
from viam.proto.common import PointCloud as ViamCloud

from so101_motion.planning.collision.scene import PointCloud, Scene
from so101_motion.planning.collision.shape_files import read_shape
from so101_motion.viam.conversion.frames import Frames
from so101_motion.viam.conversion.geometries import pcd
from so101_motion.viam.conversion.world_state import scene_with

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
    seen = Geometry(label="seen", center=center, pointcloud=ViamCloud(point_cloud=data))
    return WorldState(
        obstacles=[GeometriesInFrame(reference_frame="arm_origin", geometries=[seen])]
    )


CLOUDS = {
    "points where they are, no centre": cloud(CUBE_AT_MM, NO_CENTRE),
    "points where they are, a centre of nothing": cloud(CUBE_AT_MM, AT_ORIGIN),
    "points around their centre": cloud(0.0, MIDDLE),
    # As viam-server forwards any cloud, which loses its centre and gets the middle of its points
    # when it is parsed and serialised again: seen with RDK b0d2f62e93 of 2026-08-21.
    "points where they are, their middle as centre": cloud(CUBE_AT_MM, MIDDLE),
}


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
