"""Load the module from another process while ``bench_stop`` stops its arm.

``ATTACKS`` is the table of loads: coroutines that go on until they are cancelled. Large messages
are made once and sent again and again.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import signal
import sys
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.struct_pb2 import Struct
from grpclib import GRPCError
from grpclib.client import Channel
from viam.components.arm.client import ArmClient
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
from viam.services.motion import MotionClient

ARM, PLANNER = "other", "other planner"
"""The arm that the large worlds are sent to: another one of the same module, because a move ends an
older one of its own arm."""

SEED = 7


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """The module under attack.

    Attributes:
        socket: Where it listens.
        pid: Its process.
    """

    socket: str
    pid: int

    @contextlib.contextmanager
    def connected(self) -> Any:
        """A connection of its own."""
        channel = Channel(path=self.socket)
        try:
            yield channel
        finally:
            channel.close()


async def nothing(target: Target) -> None:
    """Leave it alone."""
    await asyncio.Event().wait()


def sending(
    send: Callable[..., Awaitable[None]], *numbers: int
) -> Callable[[Target], Awaitable[None]]:
    """Send large messages; see ``stop_attacks``."""

    async def attack(target: Target) -> None:
        with target.connected() as channel:
            await send(channel, *numbers)

    return attack


async def planning(target: Target) -> None:
    """Ask for one plan after the other."""
    with target.connected() as channel:
        planner = MotionClient("planner", channel)
        while True:
            await planner.do_command({"preview": _request(y=120.0)})
            await planner.do_command({"preview": _request(y=-120.0)})


async def abandoned_plans(target: Target) -> None:
    """Ask for 50 plans at once that take long, and give them all up; again and again."""
    with target.connected() as channel:
        planner = MotionClient("planner", channel)
        while True:
            request = {"preview": _hopeless()}
            plans = [asyncio.ensure_future(planner.do_command(request)) for _ in range(50)]
            try:
                await asyncio.wait(plans, timeout=0.5)
            finally:
                for plan in plans:
                    plan.cancel()
                await asyncio.gather(*plans, return_exceptions=True)  # refusals are expected


async def hung_planner(target: Target) -> None:
    """Ask for plans, and stop the planning process as soon as there is one; again and again."""
    with target.connected() as channel:
        planner = MotionClient("planner", channel)
        while True:
            plan = asyncio.ensure_future(planner.do_command({"preview": _request(y=120.0)}))
            await asyncio.sleep(0.2)
            for child in _children(target.pid):
                os.kill(child, signal.SIGSTOP)
            await asyncio.wait([plan], timeout=10.0)
            plan.cancel()
            await asyncio.gather(plan, return_exceptions=True)


def _children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


async def polling(target: Target, clients: int = 20, rate: float = 10.0) -> None:
    """Many independent clients, each asking for the joints ``rate`` times a second."""
    begins = np.random.default_rng(SEED).uniform(0.0, 1.0 / rate, clients)

    async def poll(begin: float) -> None:
        await asyncio.sleep(begin)
        with target.connected() as channel:
            arm = ArmClient("arm", channel)
            while True:
                await arm.get_joint_positions()
                await asyncio.sleep(1.0 / rate)

    await asyncio.gather(*map(poll, begins))


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


_REASONS = ("out of reach", "are read", "is read")
"""Why these moves may be refused: the goal, or the size of what is said to be there."""


async def _move(channel: Channel, geometries: list[Geometry]) -> None:
    """Ask for moves of the other arm that cannot be."""
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
        try:
            await motion.Move(move)
        except GRPCError as error:
            if not any(reason in str(error.message) for reason in _REASONS):
                raise SystemExit(f"refused for another reason: {error.message}") from error


def _request(*, y: float) -> dict[str, Any]:
    """A MoveRequest as JSON."""
    there = {"reference_frame": "arm_origin", "pose": {"x": 200, "y": y, "z": 150, "o_z": 1}}
    return {"component_name": "arm", "destination": there}


def _hopeless() -> dict[str, Any]:
    """The same behind a wall, under a roof: both ends are free, the way between them is not."""
    azimuth = math.radians(50.0)
    wall = {
        "label": "wall",
        "box": {"dims_mm": {"x": 700, "y": 6, "z": 900}},
        "center": {
            "x": 430.0 * math.cos(azimuth),
            "y": 430.0 * math.sin(azimuth),
            "z": 350,
            "o_z": 1,
            "theta": 50,
        },
    }
    roof = {
        "label": "roof",
        "box": {"dims_mm": {"x": 1000, "y": 1000, "z": 10}},
        "center": {"z": 280, "o_z": 1},
    }
    around = {"reference_frame": "arm_origin", "geometries": [wall, roof]}
    there = {"x": -65, "y": 241, "z": 120, "o_z": 1}
    return {
        "component_name": "arm",
        "destination": {"reference_frame": "arm_origin", "pose": there},
        "world_state": {"obstacles": [around]},
    }


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


ATTACKS: Mapping[str, Callable[[Target], Awaitable[None]]] = {
    "nothing else": nothing,
    "one plan after the other": planning,
    "50 abandoned plans": abandoned_plans,
    "a hung planner": hung_planner,
    "20 polling clients": polling,
    "200 clients, 1 Hz each": lambda target: polling(target, clients=200, rate=1.0),
    "texts of 1 MB": sending(long_texts),
    "1,000 boxes": sending(many_boxes, 1_000),
    "100,000 boxes": sending(many_boxes, 100_000),
    "a mesh of 250,000 triangles": sending(large_mesh, 250_000),
    "a mesh of 1,000,000 triangles": sending(large_mesh, 1_000_000),
    "a cloud of 1,000,000 points": sending(large_cloud, 1_000_000),
}
"""The attacks that keep the module busy, by the name of the row."""


def attack(name: str, socket: str, pid: str) -> None:
    """Be the attacker until terminated; refusals by the module are ignored."""

    async def go_on() -> None:
        me = asyncio.current_task()
        assert me is not None
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, me.cancel)
        print("begun", flush=True)
        while True:
            with contextlib.suppress(Exception):
                await ATTACKS[name](Target(socket=socket, pid=int(pid)))
            await asyncio.sleep(0.01)

    with contextlib.suppress(asyncio.CancelledError):
        asyncio.run(go_on())


if __name__ == "__main__":
    attack(*sys.argv[1:])
