"""Change a message as a real viam-server does when it forwards it to a module.

It parses every message into its own types and serialises it again, which changes some fields. Seen
with RDK b0d2f62e93 of 2026-08-21.
"""

import numpy as np
from viam.proto.common import GeometriesInFrame, Pose, WorldState

from so101_motion.planning.collision.scene import PointCloud
from so101_motion.planning.collision.shape_files import read_shape
from so101_motion.viam.conversion.geometries import from_geometry
from so101_motion.viam.conversion.world_state_json import pcd


def sent_on(world):
    """A WorldState as a module gets it through viam-server."""
    return WorldState(
        obstacles=[
            GeometriesInFrame(
                reference_frame=group.reference_frame,
                geometries=[geometry_sent_on(one) for one in group.geometries],
            )
            for group in world.obstacles
        ],
        transforms=world.transforms,
    )


def geometry_sent_on(geometry):
    """Clouds lose their centre and get the middle of their points; every mesh is called PLY."""
    sent = type(geometry)()
    sent.CopyFrom(geometry)
    kind = geometry.WhichOneof("geometry_type")
    if kind == "mesh":
        sent.mesh.content_type = "ply"
    if kind == "pointcloud":
        bare = type(geometry)(pointcloud=geometry.pointcloud)
        points = read_shape(from_geometry(bare)).points
        x, y, z = (float(value) for value in 500.0 * (points.min(axis=0) + points.max(axis=0)))
        sent.center.CopyFrom(Pose(x=x, y=y, z=z, o_z=1.0))
        sent.pointcloud.point_cloud = pcd(PointCloud(points=np.asarray(points)))
    return sent
