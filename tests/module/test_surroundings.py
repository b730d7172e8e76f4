"""Arms plan around what their machine has, read over gRPC: components of the frame system, a store,
what a camera in their hand sees, and a vision service that looks through it.
"""

import asyncio
import json
from contextlib import asynccontextmanager

import numpy as np
import pytest
import pytest_asyncio
from grpclib import GRPCError, Status
from harness.emulated_port import in_the_end
from harness.fake_camera import FakeCamera, FakeVision, picture
from harness.fake_machine import FakeMachine, FakeStore, Thing, a_box, hanging, seen_thing
from harness.fake_parent import ARM, GRIPPER, MOTION, SIMULATED, SIMULATED_GRIPPER, running_module
from harness.in_process_module import refused
from viam.components.arm import JointPositions, MoveOptions
from viam.components.camera.service import CameraRPCService
from viam.components.generic.service import GenericRPCService
from viam.proto.common import Pose, PoseInFrame
from viam.resource.manager import ResourceManager
from viam.services.vision.service import VisionRPCService
from viam.services.worldstatestore.service import WorldStateStoreService

from so101_motion.common.geometry import SE3
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.viam.conversion import convert

pytestmark = pytest.mark.asyncio(loop_scope="module")

MODEL = RobotModel.load()
QUICK = {"speed_degs_per_sec": 180, "acceleration_degs_per_sec_per_sec": 500}
BOX_MM, SIZE_MM = np.array([220.0, 120.0, 150.0]), np.array([40.0, 40.0, 300.0])
FRAME = "arm_origin"


class Bench:
    """The module's process with an arm and a motion service, and its machine."""

    def __init__(self, module, things, *frames):
        self.module, self.manager = module, things
        module.parent.machine = FakeMachine(*frames)

    def register(self, resource):
        self.manager.register(resource)
        self.module.parent.resources.append(resource.get_resource_name(resource.name))

    async def plan(self, *xyz, component="arm", **world):
        pose = dict(zip(("x", "y", "z"), xyz, strict=True), oZ=1)
        destination = {"referenceFrame": FRAME, "pose": pose}
        request = {"componentName": component, "destination": destination} | world
        preview = {"preview": json.dumps(request)}
        return (await in_the_end(lambda: self.motion.do_command(preview)))["preview"]

    async def go(self, *xyz):
        x, y, z = xyz
        await in_the_end(lambda: self.arm.move_to_position(Pose(x=x, y=y, z=z, o_z=1)))


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def process():
    """The module's process, for both tests: a start costs a second."""
    manager = ResourceManager()
    kinds = (GenericRPCService, WorldStateStoreService, CameraRPCService, VisionRPCService)
    async with running_module(services=[kind(manager) for kind in kinds]) as (module, _, _):
        yield module, manager


def outside_the_box(tool_path_mm):
    """How far a path stays from the box [mm]; 0 when it enters."""
    away = np.abs(np.array(tool_path_mm) - BOX_MM) - SIZE_MM / 2.0
    return float(np.linalg.norm(np.maximum(away, 0.0), axis=1).min())


T_ARM_LEFT = SE3.from_rpy((0.0, 0.0, -np.pi / 2.0), (0.2, 0.45, 0.0))
OURS = [  # the left arm stretches before the other
    hanging("arm", joints=5),
    hanging("left", x=200.0, y=450.0, theta=-90.0, joints=5),
    hanging("gripper", "arm"),
]


class TwoArms(Bench):
    """With another arm, a gripper and a store."""

    async def begin(self):
        self.store = FakeStore()
        self.register(self.store)
        self.arm = await self.module.add(ARM, SIMULATED, QUICK, "arm")
        self.left = await self.module.add(ARM, SIMULATED, QUICK, "left")
        await self.module.add(GRIPPER, SIMULATED_GRIPPER, {}, "gripper")
        self.motion = await self.module.add(
            MOTION,
            "devrel:so101:motion",
            {"world_state_store": "seen"},
            "planner",
            dependencies=["rdk:service:world_state_store/seen"],
        )
        return self

    async def end(self):
        for api, name in ((MOTION, "planner"), (GRIPPER, "gripper"), (ARM, "left"), (ARM, "arm")):
            await self.module.remove(api, name)
        self.module.parent.resources.clear()

    def has(self, *configs):
        """Put components around the arms; each is running."""
        machine = self.module.parent.machine
        machine.configs = [*OURS, *configs]
        for config in configs:
            self.add(Thing(config.frame.reference_frame))

    def add(self, thing):
        self.register(thing)
        self.module.parent.machine.things[thing.name] = thing

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


async def test_the_machine_is_planned_around(process):
    bench = await TwoArms(*process, *OURS).begin()

    # Through the other arm: its tool is no place for this one's.
    tool = convert.from_pose(await bench.left.get_end_position())
    met = T_ARM_LEFT @ tool
    await bench.both_refuse(*(1000.0 * met.p), of="left's ")

    # The other arm turns away, and the next plan knows.
    await bench.turn_left_arm(100, 60, -60, 0, 0)
    await bench.plan(*(1000.0 * met.p))

    # While it moves it is still away, and the next plan knows where it will be.
    goal = (0.0, -40.0, 40.0, 0.0, 0.0)
    met = T_ARM_LEFT @ MODEL.frame(np.radians(goal))
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
    wall = a_box(*SIZE_MM, **dict(zip("xyz", BOX_MM, strict=True)))
    await bench.go(220, 30, 120)
    before = await bench.plan(130, 220, 120)
    assert outside_the_box(before["tool_path_mm"]) < 10.0
    bench.has(hanging("wall", geometry=wall))
    await bench.both_refuse(*BOX_MM, of="'wall'")
    after = await bench.plan(130, 220, 120)
    assert outside_the_box(after["tool_path_mm"]) > 3.0
    await bench.go(130, 220, 120)

    # A component that hangs from the gripper is held: it would be in the table.
    stick = hanging("stick", "gripper", geometry=a_box(15, 15, 250, z=125.0))
    bench.has()
    await bench.plan(200, 0, 60)
    bench.has(stick)
    await bench.both_refuse(200, 0, 10, of="stick")

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
    await bench.end()


IN_HAND = hanging("camera", "arm", x=-60.0, z=-20.0, theta=30.0)
T_TOOL_CAMERA = convert.from_pose(IN_HAND.frame.pose_in_observer_frame.pose)
BOX = (BOX_MM / 1e3, SIZE_MM / 1e3)


class WithCamera(Bench):
    """An arm with a camera in its hand that sees the arm itself, a box and the table.

    Attributes:
        q: The arm's joint angles when it last rested, shape (5,), [rad].
        T_wrong: By how much the camera is mistaken about where it is.
    """

    def __init__(self, module, things):
        super().__init__(module, things, hanging("arm", joints=5), IN_HAND)
        self.q, self.T_wrong = np.zeros(5), SE3.identity()
        self.camera = FakeCamera("camera", self.look)
        self.finder = FakeVision("finder", [])
        for resource in (self.camera, self.finder):
            self.register(resource)

    @property
    def T_base_camera(self):
        """Where the camera is."""
        return MODEL.frame(self.q, "tool") @ T_TOOL_CAMERA

    def look(self):
        seen = picture(MODEL.link_placements(self.q, 0.0), [BOX], count=60_000)
        return (self.T_base_camera @ self.T_wrong).inverse @ seen

    def find(self):
        """Have the vision service find the box, and a box where the arm's gripper is."""
        crate, hand = a_box(*SIZE_MM, "crate"), a_box(60, 60, 60, "hand")
        T_base_hand = MODEL.frame(self.q, "gripper_link")
        for box, T in ((crate, SE3.from_translation(BOX[0])), (hand, T_base_hand)):
            box.center.CopyFrom(convert.to_pose(self.T_base_camera.inverse @ T))
        self.finder.objects = [(None, [crate]), (None, [hand])]

    async def looks_through(self, **senses):
        """Build the arm with these attributes, which name resources of the machine."""
        valid = await self.module.validate(ARM, SIMULATED, QUICK | senses, "arm")
        used = [*valid.dependencies, *valid.optional_dependencies]
        self.arm = await self.module.add(ARM, SIMULATED, QUICK | senses, "arm", dependencies=used)
        await self.rest()

    async def rest(self):
        """Note where the arm rests."""
        self.q = np.radians((await self.arm.get_joint_positions()).values)

    async def turn(self, *q_deg):
        there = JointPositions(values=q_deg)
        await in_the_end(lambda: self.arm.move_to_joint_positions(there))
        await self.rest()

    async def go(self, *xyz):
        await super().go(*xyz)
        await self.rest()


async def test_a_camera_in_the_hand_sees_what_is_in_the_way_wherever_the_arm_stands(process):
    bench = WithCamera(*process)
    bench.motion = await bench.module.add(MOTION, "devrel:so101:motion", {}, "planner")
    await bench.looks_through(camera="camera", vision="finder")
    bench.find()
    with pytest.raises(GRPCError, match="'crate'"):
        await bench.go(*BOX_MM)
    await bench.go(220, 30, 120)  # the hand that it finds is no obstacle
    assert bench.camera.looks == 0
    await bench.module.remove(ARM, "arm")
    await bench.looks_through(camera="camera")
    await bench.turn(0, -45, 45, 60, 0)  # the arm itself is not in its own way
    with pytest.raises(GRPCError, match="'camera'"):
        await bench.go(*BOX_MM)
    await bench.go(220, 30, 120)  # the camera moves with the hand, and the box stays
    with pytest.raises(GRPCError, match="'camera'"):
        await bench.go(*BOX_MM)
    assert outside_the_box((await bench.plan(130, 220, 120))["tool_path_mm"]) > 3.0
    await bench.go(130, 220, 120)
    assert bench.camera.looks >= 6
    with pytest.raises(GRPCError, match="'camera'"):
        await bench.go(*BOX_MM)

    # Were the arm not cut out, it would be an obstacle: it is where it is taken for another.
    bench.T_wrong = SE3.from_translation((0.08, 0.0, 0.0))
    with pytest.raises(GRPCError, match="'camera'"):
        await bench.go(220, 30, 120)
