"""What ``bench_stop`` has a hostile client send: large messages, over and over again.

Each is made once, in the attacker's process, and sent as it is.
"""

from __future__ import annotations

import contextlib

import numpy as np
from google.protobuf.struct_pb2 import Struct
from grpclib import GRPCError
from grpclib.client import Channel
from viam.gen.component.arm.v1.arm_grpc import ArmServiceStub
from viam.gen.service.motion.v1.motion_grpc import MotionServiceStub
from viam.proto.common import (
    DoCommandRequest,
    GeometriesInFrame,
    Geometry,
    Mesh,
    PointCloud,
    Pose,
    PoseInFrame,
    RectangularPrism,
    Vector3,
    WorldState,
)
from viam.proto.service.motion import MoveRequest

ARM, PLANNER = "other", "other planner"
"""What the large worlds are sent to: another arm of the same module, for a move ends an older one
of its own arm."""

SEED = 7


async def long_texts(channel: Channel) -> None:
    """Commands of a million characters, ASCII and not."""
    arm = ArmServiceStub(channel)
    requests = []
    for text in ("a" * 1_000_000, "é" * 500_000, "é" * 100_000):
        for content in ({"command": text}, {text: 1.0}):
            command = Struct()
            command.update(content)
            requests.append(DoCommandRequest(name="arm", command=command))
    while True:
        for request in requests:
            with contextlib.suppress(GRPCError):
                await arm.DoCommand(request)


async def many_boxes(channel: Channel, count: int) -> None:
    """A world of boxes that all have one label."""
    box = Geometry(label="box", box=RectangularPrism(dims_mm=Vector3(x=5, y=5, z=5)))
    await _move(channel, [box] * count)


async def large_mesh(channel: Channel, triangles: int) -> None:
    """A binary PLY file of a wavy sheet; its triangles share their vertices."""
    mesh = Mesh(content_type="ply", mesh=_ply(triangles))
    await _move(channel, [Geometry(label="part", mesh=mesh)])


async def large_cloud(channel: Channel, points: int) -> None:
    """A binary PCD file."""
    cloud = PointCloud(point_cloud=_pcd(points))
    await _move(channel, [Geometry(label="seen", pointcloud=cloud)])


async def _move(channel: Channel, geometries: list[Geometry]) -> None:
    """Ask for moves of the other arm that cannot be, for the goal is out of reach."""
    around = GeometriesInFrame(reference_frame=f"{ARM}_origin", geometries=geometries)
    goal = PoseInFrame(reference_frame=f"{ARM}_origin", pose=Pose(x=2_000, o_z=1))
    move = MoveRequest(
        name=PLANNER,
        component_name=ARM,
        destination=goal,
        world_state=WorldState(obstacles=[around]),
    )
    motion = MotionServiceStub(channel)
    while True:
        with contextlib.suppress(GRPCError):
            await motion.Move(move)


def _ply(triangles: int) -> bytes:
    n = int(np.ceil(np.sqrt(triangles / 2)))
    x, y = np.meshgrid(np.linspace(0.4, 0.6, n + 1), np.linspace(-0.1, 0.1, n + 1))
    corners = np.stack([x, y, 0.1 + 0.01 * np.sin(50.0 * x)], axis=-1).astype("<f4").reshape(-1, 3)
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    lower = np.stack([first, first + 1, first + n + 1], axis=1)
    upper = np.stack([first + 1, first + n + 2, first + n + 1], axis=1)
    faces = np.zeros(triangles, np.dtype([("n", "u1"), ("corners", "<i4", 3)]))
    faces["n"], faces["corners"] = 3, np.concatenate([lower, upper])[:triangles]
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(corners)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {triangles}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return head.encode() + corners.tobytes() + faces.tobytes()


def _pcd(points: int) -> bytes:
    seen = np.random.default_rng(SEED).uniform(0.4, 0.6, (points, 3)).astype("<f4")
    head = (
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA binary\n"
    )
    return head.encode() + seen.tobytes()
