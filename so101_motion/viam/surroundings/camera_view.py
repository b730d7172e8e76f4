"""Look with a camera before a plan is made.

The points of a camera, or the objects that a vision service finds in its picture, are where the
camera was when it looked. So its place is asked for before and after; if it or the arm has moved
meanwhile, it looks again. The arm itself and what it holds are cut out of what was seen. A camera
that does not answer, or sees nothing at all, is no reason to take the space for empty.
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
"""So often it looks at most, when something moves meanwhile; chosen."""

_MOVED = 0.005
"""What has moved less has not [m], at half a metre from the camera; chosen, half a cube."""

_Seen = bytes | list[PointCloudObject]
_Things = list[tuple[str, Shape | ShapeFile, SE3]]

_WHOLE = 0.9
"""An object of which so much is left without the arm is taken as its box; chosen."""


class CameraView:
    """What a camera sees, or a vision service in its picture. Belongs to the event loop.

    Args:
        camera: The camera's name, which is that of its frame.
        client: A client of it; None if it does not run.
        vision: A vision service's name; None for the camera's points.
        finder: A client of it; None if it does not run, or is not asked.
        patience: How long it may take to look [s].
    """

    is_steady = False

    def __init__(
        self,
        camera: str,
        client: Camera | None,
        vision: str | None = None,
        finder: Vision | None = None,
        *,
        patience: float = LONGEST_LOOK,
    ) -> None:
        self._camera, self._client = camera, client
        self._vision, self._finder = vision, finder
        self._patience = patience

    async def added_to(self, scene: Scene, view: MachineView) -> Scene:
        """``scene`` with what is seen now.

        Raises:
            SurroundingsUnknown: Nothing can be seen, or something moves all the time.
        """
        try:
            async with asyncio.timeout(self._patience):
                seen, view, T_base_camera = await self._steady_look(view)
            return await asyncio.to_thread(self._placed, seen, scene, view, T_base_camera)
        except TimeoutError as error:
            raise self._unknown(f"has not looked within {self._patience:g} s") from error
        except GRPCError as error:
            reason = f"does not look: {error.message}"
            if self._vision is not None:
                reason = f'or the vision service "{self._vision}" {reason}'
            raise self._unknown(reason) from error
        except ConfigError as error:
            raise self._unknown(f"sees something that is not valid: {error}") from error

    async def _steady_look(self, view: MachineView) -> tuple[_Seen, MachineView, SE3]:
        """What it sees while nothing moves, the machine at that moment, and where it is."""
        for _ in range(_TRIES):
            T_base_camera = await view.frames().T_base(self._camera)
            seen = await self._look()
            now = await view.read_again()
            there = await now.frames().T_base(self._camera)
            if _stood_still(view, now) and nearly(T_base_camera, there, _MOVED):
                return seen, now, T_base_camera
            view = now
        raise self._unknown(f"or the arm moved whenever it looked, {_TRIES} times")

    async def close(self) -> None:
        """It looks only when it is asked."""

    async def _look(self) -> _Seen:
        if self._client is None:
            raise self._unknown("does not run")
        if self._vision is None:
            data, _ = await self._client.get_point_cloud(timeout=self._patience)
            return data
        if self._finder is None:
            raise self._unknown(
                f'is asked by the vision service "{self._vision}", which does not run'
            )
        return await self._finder.get_object_point_clouds(self._camera, timeout=self._patience)

    def _placed(
        self,
        seen: _Seen,
        scene: Scene,
        view: MachineView,
        T_base_camera: SE3,
    ) -> Scene:
        names = UniqueNames(taken_in(scene))
        things: _Things
        if isinstance(seen, bytes):
            points = _finite(read_points(seen))
            if len(points) == 0:
                raise self._unknown("sees nothing at all, not even the table")
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
        """Each object as its geometries, or as what is left of its points without the arm."""
        count = sum(max(1, len(each.geometries.geometries)) for each in found)
        if count > MOST_THINGS:
            raise ConfigError("objects", count, f"are more than {MOST_THINGS}")
        things: _Things = []
        own = partial(
            of_the_arm,
            T_base_links=view.T_links,
            T_base_tool=view.T_base_tool,
            held=scene.attached,
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
            remedy="put that right, or take it out of the configuration",
        )


def _finite(points: Array) -> Array:
    return points[np.isfinite(points).all(axis=1)]


def _stood_still(view: MachineView, now: MachineView) -> bool:
    return all(nearly(T, now.T_links[link], _MOVED) for link, T in view.T_links.items())
