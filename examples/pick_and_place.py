"""Pick a cube from the table, carry it around a wall and put it down, as a client of Viam.

Without arguments it starts the module by itself, with the simulated arm, and talks to it as
viam-server would::

    python examples/pick_and_place.py

On a machine it needs an arm, a gripper and the motion service of this module (machine.json beside
this file has all three), and MOVES THE ARM::

    VIAM_API_KEY=... VIAM_API_KEY_ID=... python examples/pick_and_place.py --machine ADDRESS

All poses are in the arm's base frame, in millimetres: x ahead, y to the left, z up.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from google.protobuf.struct_pb2 import Struct
from grpclib.client import Channel
from viam.components.arm import Arm
from viam.components.arm.client import ArmClient
from viam.components.gripper import Gripper
from viam.components.gripper.client import GripperClient
from viam.proto.app.robot import ComponentConfig
from viam.proto.common import (
    GeometriesInFrame,
    Geometry,
    Pose,
    PoseInFrame,
    RectangularPrism,
    Transform,
    Vector3,
    WorldState,
)
from viam.proto.module import AddResourceRequest, ModuleServiceStub, ReadyRequest
from viam.proto.service.motion import Constraints, LinearConstraint
from viam.robot.client import RobotClient
from viam.services.motion import Motion, MotionClient

PICK, PLACE = (200.0, -140.0), (200.0, 140.0)
LOW, HIGH = 112.0, 160.0
"""Height of the tool frame, down at the cube and above it. Pointing down, the tip of the jaw is
98 mm below it, so it takes the cube some millimetres above its middle, and free of the table."""
TIP = Pose(x=7.9, z=98.1, o_z=1.0)
"""The tip of the jaw in the tool frame."""
CUBE = 20.0
QUICK = {"speed_degs_per_sec": 180.0, "acceleration_degs_per_sec_per_sec": 500.0}
FROM_ABOVE = {"goal_metric_type": "position_and_approach"}
STRAIGHT = Constraints(
    linear_constraint=[LinearConstraint(line_tolerance_mm=1.0, orientation_tolerance_degs=5.0)]
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Robot:
    """The machine's components that the task uses."""

    arm: Arm
    gripper: Gripper
    motion: Motion

    async def bring_tool(self, x: float, y: float, z: float, *, held: bool, line: bool) -> None:
        """The tool, pointing down, to a point; around what is in the way or straight."""
        name = self.arm.name
        down = Pose(x=x, y=y, z=z, o_z=-1.0)
        await self.motion.move(
            name,
            PoseInFrame(reference_frame=f"{name}_origin", pose=down),
            surroundings(name, held=held),
            STRAIGHT if line else None,
            extra=FROM_ABOVE,
        )
        end = await self.arm.get_end_position()
        print(f"  tool at ({end.x:.1f}, {end.y:.1f}, {end.z:.1f}) mm")


async def pick_and_place(robot: Robot) -> None:
    """The task."""
    print("picking")
    await robot.gripper.open()
    await robot.bring_tool(*PICK, HIGH, held=False, line=False)
    await robot.bring_tool(*PICK, LOW, held=False, line=True)
    await robot.gripper.grab()  # the simulated jaw meets nothing and closes on air
    print("carrying it around the wall")
    await robot.bring_tool(*PICK, HIGH, held=True, line=True)
    await robot.bring_tool(*PLACE, HIGH, held=True, line=False)
    print("putting it down")
    await robot.bring_tool(*PLACE, LOW, held=True, line=True)
    await robot.gripper.open()
    await robot.bring_tool(*PLACE, HIGH, held=False, line=True)
    print("done")


def surroundings(arm: str, *, held: bool) -> WorldState:
    """A wall across the table and, once it is held, the cube.

    What is given as a transform hangs from its frame, here the tool's, and moves with it.
    """
    wall = GeometriesInFrame(
        reference_frame=f"{arm}_origin",
        geometries=[box("wall", (120.0, 20.0, 130.0), Pose(x=240.0, z=65.0, o_z=1.0))],
    )
    cube = Transform(
        reference_frame="cube",
        pose_in_observer_frame=PoseInFrame(reference_frame=arm, pose=TIP),
        physical_object=box("cube", (CUBE, CUBE, CUBE), Pose(o_z=1.0)),
    )
    return WorldState(obstacles=[wall], transforms=[cube] if held else [])


def box(name: str, size: tuple[float, float, float], center: Pose) -> Geometry:
    """A box of a size around a point of its frame."""
    prism = RectangularPrism(dims_mm=Vector3(x=size[0], y=size[1], z=size[2]))
    return Geometry(label=name, box=prism, center=center)


@asynccontextmanager
async def on_machine(address: str) -> AsyncIterator[Robot]:
    """The resources of a running machine; the key comes from the environment."""
    options = RobotClient.Options.with_api_key(
        api_key=os.environ["VIAM_API_KEY"], api_key_id=os.environ["VIAM_API_KEY_ID"]
    )
    async with await RobotClient.at_address(address, options) as machine:
        yield Robot(
            arm=Arm.from_robot(machine, "arm"),
            gripper=Gripper.from_robot(machine, "gripper"),
            motion=Motion.from_robot(machine, "planner"),
        )


@asynccontextmanager
async def on_own_module() -> AsyncIterator[Robot]:
    """A module process of our own with simulated resources."""
    folder = tempfile.TemporaryDirectory(prefix="so101-")  # short: a socket's path has 107 bytes
    socket = Path(folder.name) / "m.sock"
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "so101_motion", str(socket)),
        env={**os.environ, "VIAM_NO_MODULE_PARENT": "true"},
        stdout=asyncio.subprocess.DEVNULL,
    )
    channel = Channel(path=str(socket))
    module = ModuleServiceStub(channel)
    try:
        async with asyncio.timeout(120.0):
            while True:
                try:
                    await module.Ready(ReadyRequest(parent_address=str(socket)))
                    break
                except OSError:  # it does not listen yet
                    if process.returncode is not None:
                        text = f"the module ended at once, code {process.returncode}"
                        raise RuntimeError(text) from None
                    await asyncio.sleep(0.02)
        for name, api, model in (
            ("arm", "rdk:component:arm", "devrel:so101:simulated"),
            ("gripper", "rdk:component:gripper", "devrel:so101:simulated-gripper"),
            ("planner", "rdk:service:motion", "devrel:so101:motion"),
        ):
            config = ComponentConfig(name=name, api=api, model=model, attributes=Struct())
            if name == "arm":
                config.attributes.update(QUICK)
            await module.AddResource(AddResourceRequest(config=config))
        yield Robot(
            arm=ArmClient("arm", channel),
            gripper=GripperClient("gripper", channel),
            motion=MotionClient("planner", channel),
        )
    finally:
        channel.close()
        if process.returncode is None:
            process.terminate()
        await process.wait()
        folder.cleanup()


async def main() -> None:
    """Run the task where the arguments say."""
    parser = argparse.ArgumentParser(description="Pick a cube and put it down behind a wall.")
    parser.add_argument("--machine", metavar="ADDRESS", help="a machine, whose arm WILL move")
    address = parser.parse_args().machine
    async with on_machine(address) if address else on_own_module() as robot:
        await pick_and_place(robot)


if __name__ == "__main__":
    asyncio.run(main())
