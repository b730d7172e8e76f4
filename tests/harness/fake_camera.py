"""A depth camera that looks at an arm, and a vision service that finds boxes in its picture."""

import numpy as np
import so101_description
import trimesh
from grpclib import GRPCError, Status
from trimesh.sample import sample_surface
from viam.components.camera import Camera
from viam.proto.common import GeometriesInFrame, PointCloudObject
from viam.services.vision import Vision

NOISE = 0.002  # of every point along every axis [m], as a depth camera at half a metre
STRAYS = 60  # points in the air


def pcd(points):
    """Points, shape (n, 3), [m], as Viam's cameras send them."""
    head = (
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\n"
        "DATA binary\n"
    )
    return head.encode() + points.astype("<f4").tobytes()


def picture(T_base_links, boxes, *, count, seed=0):
    """What a camera sees of an arm, boxes (center, size) and a table, shape (count, 3), in base."""
    rng = np.random.default_rng(seed)
    share = count // 10
    parts = []
    for link, T in T_base_links.items():
        hull = so101_description.load_hull(so101_description.PARTS[link])
        surface = trimesh.Trimesh(hull.vertices, hull.faces)
        parts.append(T @ sample_surface(surface, share // 2, seed=rng)[0])
    for center, size in boxes:
        parts.append(center + sample_surface(trimesh.creation.box(size), share, seed=rng)[0])
    parts.append(rng.uniform((-0.5, -0.5, 0.1), (0.6, 0.5, 0.6), (STRAYS, 3)))
    table = rng.uniform((-0.6, -0.6), (0.8, 0.6), (count - sum(map(len, parts)), 2))
    parts.append(np.column_stack([table, np.full(len(table), -0.0024)]))
    points = np.concatenate(parts)
    return points + NOISE * rng.standard_normal(points.shape)


class FakeCamera(Camera):
    """Sees what ``look`` gives it, in its own frame; an exception is raised."""

    def __init__(self, name, look):
        super().__init__(name)
        self.look, self.looks = look, 0

    async def get_point_cloud(self, **kwargs):
        self.looks += 1
        points = self.look()
        if isinstance(points, Exception):
            raise points
        return pcd(points), "pointcloud/pcd"

    async def get_geometries(self, **kwargs):
        raise GRPCError(Status.UNIMPLEMENTED, "no geometries")

    async def get_images(self, **kwargs):
        raise NotImplementedError

    async def get_properties(self, **kwargs):
        raise NotImplementedError


class FakeVision(Vision):
    """Finds objects: ``(points or None, boxes)`` each, in the camera's frame; or raises one."""

    def __init__(self, name, objects):
        super().__init__(name)
        self.objects = objects

    async def get_object_point_clouds(self, camera_name, **kwargs):
        if isinstance(self.objects, Exception):
            raise self.objects
        return [
            PointCloudObject(
                point_cloud=b"" if points is None else pcd(points),
                geometries=GeometriesInFrame(reference_frame=camera_name, geometries=boxes),
            )
            for points, boxes in self.objects
        ]

    async def _not_here(self, *args, **kwargs):
        raise NotImplementedError

    capture_all_from_camera = get_detections_from_camera = get_detections = _not_here
    get_classifications_from_camera = get_classifications = get_detections_3d = _not_here
    get_properties = _not_here
