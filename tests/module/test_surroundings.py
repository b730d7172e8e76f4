"""Arms plan around their machine's components, read over gRPC from the frame system."""

import asyncio
import json
from contextlib import asynccontextmanager

import numpy as np
import pytest
from grpclib import GRPCError, Status
from harness.emulated_port import in_the_end
from harness.fake_machine import FakeMachine, FakeStore, Thing, a_box, hanging, seen_thing
from harness.fake_parent import ARM, GRIPPER, MOTION, SIMULATED, SIMULATED_GRIPPER, running_module
from harness.in_process_module import refused
from viam.components.arm import JointPositions, MoveOptions
from viam.components.generic.service import GenericRPCService
from viam.proto.common import Pose, PoseInFrame
from viam.resource.manager import ResourceManager
from viam.services.worldstatestore.service import WorldStateStoreService

from so101_motion.common.geometry import SE3
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.viam.conversion import convert

T_ARM_LEFT = SE3.from_rpy((0.0, 0.0, -np.pi / 2.0), (0.2, 0.45, 0.0))
OURS = [  # the left arm stretches before the other
    hanging("arm", joints=5),
    hanging("left", x=200.0, y=450.0, theta=-90.0, joints=5),
    hanging("gripper", "arm"),
]
FRAME = "arm_origin"


class Bench:
    """The module's process with two arms, a gripper and a motion service, and its machine."""

    def __init__(self, module, things):
        self.module, self.manager = module, things

    async def begin(self, **attributes):
        self.module.parent.machine = FakeMachine(*OURS)
        self.store = FakeStore()
        self.manager.register(self.store)
        self.module.parent.resources.append(self.store.get_resource_name("seen"))
        quick = {"speed_degs_per_sec": 180, "acceleration_degs_per_sec_per_sec": 500}
        self.arm = await self.module.add(ARM, SIMULATED, quick | attributes, "arm")
        self.left = await self.module.add(ARM, SIMULATED, quick, "left")
        await self.module.add(GRIPPER, SIMULATED_GRIPPER, {}, "gripper")
        self.motion = await self.module.add(
            MOTION,
            "devrel:so101:motion",
            {"world_state_store": "seen"},
            "planner",
            dependencies=["rdk:service:world_state_store/seen"],
        )
        return self

    def has(self, *configs):
        """Put components around the arms; each is running."""
        machine = self.module.parent.machine
        machine.configs = [*OURS, *configs]
        for config in configs:
            self.add(Thing(config.frame.reference_frame))

    def add(self, thing):
        self.manager.register(thing)
        self.module.parent.machine.things[thing.name] = thing
        self.module.parent.resources.append(Thing.get_resource_name(thing.name))

    async def plan(self, *xyz, component="arm", **world):
        pose = dict(zip(("x", "y", "z"), xyz, strict=True), oZ=1)
        destination = {"referenceFrame": FRAME, "pose": pose}
        request = {"componentName": component, "destination": destination} | world
        preview = {"preview": json.dumps(request)}
        return (await in_the_end(lambda: self.motion.do_command(preview)))["preview"]

    async def go(self, *xyz):
        x, y, z = xyz
        await in_the_end(lambda: self.arm.move_to_position(Pose(x=x, y=y, z=z, o_z=1)))

    async def turn_left_arm(self, *q_deg):
        there = JointPositions(values=q_deg)
        await in_the_end(lambda: self.left.move_to_joint_positions(there))

    @asynccontextmanager
    async def left_under_way(self, *q_goal, speed_deg=4.0):
        """While the left arm has begun a slow motion to some angles [deg]."""
        slowly, goal = MoveOptions(max_vel_degs_per_sec=speed_deg), [JointPositions(values=q_goal)]
        first = (await self.left_angles())[0]
        going = asyncio.create_task(self.left.move_through_joint_positions(goal, slowly))
        try:
            for _ in range(1000):  # it is another process that moves
                if going.done() or abs((await self.left_angles())[0] - first) > 1.0:
                    break
                await asyncio.sleep(0.02)
            yield
        finally:
            await self.left.stop()
            with pytest.raises(GRPCError, match=r"ended early by stop|no setpoint could be sent"):
                await going

    async def left_angles(self):
        return (await self.left.get_joint_positions()).values

    async def both_refuse(self, *xyz, of):
        """Both ways to ask for it, and what they name."""
        x, y, z = xyz
        await refused(self.go(*xyz), Status.FAILED_PRECONDITION, of)
        there = PoseInFrame(reference_frame=FRAME, pose=Pose(x=x, y=y, z=z, o_z=1))
        with pytest.raises(GRPCError, match=of):
            await in_the_end(lambda: self.motion.move("arm", there))


@pytest.fixture
async def process():
    manager = ResourceManager()
    services = [GenericRPCService(manager), WorldStateStoreService(manager)]
    async with running_module(services=services) as (module, _, _):
        yield Bench(module, manager)


def outside(tool_path_mm, center, size):
    """How far a path stays from a box [mm]; 0 when it enters."""
    away = np.abs(np.array(tool_path_mm) - center) - np.array(size) / 2.0
    return float(np.linalg.norm(np.maximum(away, 0.0), axis=1).min())


async def test_the_machine_is_planned_around(process):
    """One process for all of it: a start costs a second."""
    bench = await process.begin()

    # Through the other arm: its tool is no place for this one's.
    tool = convert.from_pose(await bench.left.get_end_position())
    met = T_ARM_LEFT @ tool
    await bench.both_refuse(*(1000.0 * met.p), of="left's ")

    # The other arm turns away, and the next plan knows.
    await bench.turn_left_arm(100, 60, -60, 0, 0)
    await bench.plan(*(1000.0 * met.p))

    # While it moves it is still away, and the next plan knows where it will be.
    goal = (0.0, -40.0, 40.0, 0.0, 0.0)
    met = T_ARM_LEFT @ RobotModel.load().frame(np.radians(goal))
    await bench.plan(*(1000.0 * met.p))
    async with bench.left_under_way(*goal):
        await bench.both_refuse(*(1000.0 * met.p), of="left's ")
    allows = [{"frame1": "arm", "frame2": "left"}]
    except_it = {"collisionSpecification": [{"allows": allows}]}
    with pytest.raises(GRPCError, match="contact with it cannot be allowed"):
        await bench.plan(*(1000.0 * met.p), constraints=except_it)

    # It is leaving: the next plan waits for that and says so.
    await bench.turn_left_arm(*goal)
    async with bench.left_under_way(100, 60, -60, 0, 0, speed_deg=1.0):
        waiting = await bench.plan(*(1000.0 * met.p))
    assert waiting["waits_for"] == ["left"]
    assert 0.0 < waiting["waits_s"] < waiting["duration_s"]

    # Both in one motion.
    there = {"left": {"joints_deg": [60, 0, 0, 0, 0]}, "arm": {"pose": {"x": 200, "z": 200}}}
    both = await in_the_end(lambda: bench.motion.do_command({"move_together": there}))
    assert both["move_together"]
    np.testing.assert_allclose(await bench.left_angles(), (60, 0, 0, 0, 0), atol=0.5)
    reached = await bench.arm.get_end_position()
    np.testing.assert_allclose((reached.x, reached.y, reached.z), (200, 0, 200), atol=1.0)
    with pytest.raises(GRPCError, match=r'lft.*did you mean "left"'):
        await bench.motion.do_command({"move_together": {"lft": {}}})
    await bench.turn_left_arm(100, 60, -60, 0, 0)

    # Through a box that the configuration names: refused in it, and gone around.
    center, size = (220.0, 120.0, 150.0), (40.0, 40.0, 300.0)
    wall = a_box(*size, x=center[0], y=center[1], z=center[2])
    await bench.go(220, 30, 120)
    before = await bench.plan(130, 220, 120)
    assert outside(before["tool_path_mm"], center, size) < 10.0
    bench.has(hanging("wall", geometry=wall))
    await bench.both_refuse(*center, of="'wall'")
    after = await bench.plan(130, 220, 120)
    assert outside(after["tool_path_mm"], center, size) > 3.0
    await bench.go(130, 220, 120)

    # A component that hangs from the gripper is held: it would be in the table.
    stick = hanging("stick", "gripper", geometry=a_box(15, 15, 250, z=125.0))
    bench.has()
    await bench.plan(200, 0, 60)
    bench.has(stick)
    await bench.both_refuse(200, 0, 10, of="'stick'")

    # What comes into a store, moves or goes there is in the very next plan: that asks the machine,
    # over the same connection, after the store has said so.
    bench.has()

    async def is_in_the_way():
        try:
            await bench.plan(200, 0, 100)
        except GRPCError as refused:
            return "'mug'" in refused.message
        return False

    bench.store.has(seen_thing("mug", x=200.0, z=100.0))
    assert await is_in_the_way()
    bench.store.forget("mug")
    assert not await is_in_the_way()
