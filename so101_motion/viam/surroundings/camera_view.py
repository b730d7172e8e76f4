"""Add the points or objects that a camera sees to the scene, before a plan is made.

They are relative to the camera, so its pose is read before and after the picture; if the camera or
the arm has moved meanwhile, another picture is taken. The arm itself and its held objects are cut
out. If a camera does not answer or sees no point at all, planning fails: the space is not assumed
to be empty.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial

import numpy as np
from grpclib import GRPCError
from viam.components.camera import Camera
from viam.proto.common import PointCloudObject
from viam.services.vision import Vision

from so101_motion.common.errors import ConfigError, SurroundingsUnknown
from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.scene import Obstacle, PointCloud, Scene, Shape, ShapeFile
from so101_motion.planning.collision.seen_points import EDGE, of_the_arm, seen_cubes
from so101_motion.planning.collision.shape_files import read_points
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.geometries import from_geometry
from so101_motion.viam.conversion.world_state import MOST_THINGS, UniqueNames, taken_in
from so101_motion.viam.surroundings.machine_view import MachineView, nearly

LONGEST_LOOK = 5.0
"""How long a camera may take [s], with all its tries. Chosen: many deliver twice a second."""

_TRIES = 3
"""Most pictures that are taken while something moves; chosen."""

_MOVED = 0.005
"""Less motion than this counts as none [m], at half a metre from the camera; chosen, half a
cube."""

_Seen = bytes | list[PointCloudObject]
_Things = list[tuple[str, Shape | ShapeFile, SE3]]

_WHOLE = 0.9
"""An object's own geometry is used if at least this share of it is outside the arm; chosen."""


class CameraView:
    """A camera, or a vision service that finds objects in its picture; clients may be None."""

    is_steady = False

    def __init__(
        self,
        camera: str,
        client: Camera | None,
        vision: str | None = None,
        finder: Vision | None = None,
    ) -> None:
        self.origin = ("camera", camera, vision or "")
        self._camera, self._client = camera, client
        self._vision, self._finder = vision, finder

    async def added_to(self, scene: Scene, view: MachineView) -> Scene:
        try:
            async with asyncio.timeout(LONGEST_LOOK):
                seen, view, T_base_camera = await self._steady_look(view)
            return await asyncio.to_thread(self._placed, seen, scene, view, T_base_camera)
        except TimeoutError as error:
            raise self._unknown(f"sent no picture within {LONGEST_LOOK:g} s") from error
        except GRPCError as error:
            reason = f"sends no picture: {error.message}"
            if self._vision is not None:
                reason = f'or the vision service "{self._vision}" {reason}'
            raise self._unknown(reason) from error
        except ConfigError as error:
            raise self._unknown(f"sees something that is not valid: {error}") from error

    async def _steady_look(self, view: MachineView) -> tuple[_Seen, MachineView, SE3]:
        """A picture taken while nothing moved, the machine then, and the camera's pose."""
        for _ in range(_TRIES):
            T_base_camera = await view.frames().T_base(self._camera)
            seen = await self._look()
            now = await view.read_again()
            there = await now.frames().T_base(self._camera)
            links = all(nearly(T, now.T_links[link], _MOVED) for link, T in view.T_links.items())
            if links and nearly(T_base_camera, there, _MOVED):
                return seen, now, T_base_camera
            view = now
        raise self._unknown(f"or the arm moved during each of {_TRIES} pictures")

    async def close(self) -> None:
        """Nothing to close: the camera is read only in ``added_to``."""

    async def _look(self) -> _Seen:
        if self._client is None:
            raise self._unknown("does not run")
        if self._vision is None:
            data, _ = await self._client.get_point_cloud(timeout=LONGEST_LOOK)
            return data
        if self._finder is None:
            raise self._unknown(
                f'is used by the vision service "{self._vision}", which does not run'
            )
        return await self._finder.get_object_point_clouds(self._camera, timeout=LONGEST_LOOK)

    def _placed(self, seen: _Seen, scene: Scene, view: MachineView, T_base_camera: SE3) -> Scene:
        names = UniqueNames(taken_in(scene))
        things: _Things
        if isinstance(seen, bytes):
            points = _finite(read_points(seen))
            if len(points) == 0:
                raise self._unknown("sees no point at all, not even the table")
            shapes = self._cubes(points, scene, view, T_base_camera)
            things = [(self._camera, shape, SE3.identity()) for shape in shapes]
        else:
            things = self._objects(seen, scene, view, T_base_camera)
        obstacles = [
            Obstacle(name=names.new(name), shape=shape, T_base_obstacle=T)
            for name, shape, T in things
        ]
        return replace(scene, obstacles=(*scene.obstacles, *obstacles))

    def _cubes(
        self, points: Array, scene: Scene, view: MachineView, T_base_camera: SE3
    ) -> list[PointCloud]:
        cubes = seen_cubes(
            T_base_camera @ points,
            T_base_links=view.T_links,
            T_base_tool=view.T_base_tool,
            held=scene.attached,
            floor_z=scene.floor_z,
        )
        return [PointCloud(points=cubes, resolution=EDGE)] if len(cubes) else []

    def _objects(
        self, found: list[PointCloudObject], scene: Scene, view: MachineView, T_base_camera: SE3
    ) -> _Things:
        """Each object as its geometries, or as its points outside the arm."""
        count = sum(max(1, len(each.geometries.geometries)) for each in found)
        if count > MOST_THINGS:
            raise ConfigError("objects", count, f"are more than {MOST_THINGS}; find fewer")
        things: _Things = []
        own = partial(
            of_the_arm, T_base_links=view.T_links, T_base_tool=view.T_base_tool, held=scene.attached
        )
        for each in found:
            boxes, frame = each.geometries.geometries, each.geometries.reference_frame
            if frame not in ("", self._camera):
                raise ConfigError("reference_frame", frame, "must be that of the camera")
            label = boxes[0].label if boxes and boxes[0].label else f"{self._vision} object"
            centres = [convert.from_pose(box.center) for box in boxes]
            # viam-server sends a file without points where the service gave none.
            cloud = _finite(read_points(each.point_cloud)) if each.point_cloud else np.empty((0, 3))
            marks = cloud if len(cloud) else np.array([centre.p for centre in centres])
            is_whole = not len(marks) or float(np.mean(own(T_base_camera @ marks))) <= 1.0 - _WHOLE
            if boxes and is_whole:
                things += [
                    (box.label or label, from_geometry(box), T_base_camera @ centre)
                    for box, centre in zip(boxes, centres, strict=True)
                ]
            elif len(cloud):
                shapes = self._cubes(cloud, scene, view, T_base_camera)
                things += [(label, shape, SE3.identity()) for shape in shapes]
        return things

    def _unknown(self, why: str) -> SurroundingsUnknown:
        return SurroundingsUnknown(
            f'the camera "{self._camera}" {why}',
            remedy="fix that, or remove the camera from the configuration",
        )


def _finite(points: Array) -> Array:
    return points[np.isfinite(points).all(axis=1)]
