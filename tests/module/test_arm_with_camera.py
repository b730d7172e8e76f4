"""An arm whose configuration names a camera, or a vision service that looks through it.

The camera is in the arm's own hand; the module is a process of its own, reached over gRPC.
"""

import json
from contextlib import asynccontextmanager

import numpy as np
import pytest
from grpclib import GRPCError
from harness.emulated_port import in_the_end
from harness.fake_camera import FakeCamera, FakeVision, picture
from harness.fake_machine import FakeMachine, a_box, hanging
from harness.fake_parent import ARM, MOTION, SIMULATED, running_module
from viam.components.arm import JointPositions
from viam.components.camera.service import CameraRPCService
from viam.proto.common import Pose
from viam.resource.manager import ResourceManager
from viam.services.vision.service import VisionRPCService

from so101_motion.common.geometry import SE3
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.viam.conversion import convert

MODEL = RobotModel.load()
BOX_MM, SIZE_MM = np.array([220.0, 120.0, 150.0]), np.array([40.0, 40.0, 300.0])
BOX = (BOX_MM / 1e3, SIZE_MM / 1e3)
IN_HAND = hanging("camera", "arm", x=-60.0, z=-20.0, theta=30.0)
T_TOOL_CAMERA = convert.from_pose(IN_HAND.frame.pose_in_observer_frame.pose)


class Bench:
    """An arm with a camera in its hand that sees the arm itself, a box and the table.

    Attributes:
        q: The arm's joint angles when it last rested, shape (5,), [rad].
        T_wrong: By how much the camera is mistaken about where it is.
    """

    def __init__(self):
        self.q, self.T_wrong = np.zeros(5), SE3.identity()
        self.camera = FakeCamera("camera", self.look)
        self.finder = FakeVision("finder", [])

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

    @asynccontextmanager
    async def running(self):
        """A module on a machine with the camera and the vision service."""
        camera, finder = ResourceManager([self.camera]), ResourceManager([self.finder])
        services = [CameraRPCService(camera), VisionRPCService(finder)]
        async with running_module(services=services) as (module, _, _):
            module.parent.machine = FakeMachine(hanging("arm", joints=5), IN_HAND)
            module.parent.resources += [
                FakeCamera.get_resource_name("camera"),
                FakeVision.get_resource_name("finder"),
            ]
            self.module = module
            self.motion = await module.add(MOTION, "devrel:so101:motion", {}, "planner")
            yield self

    async def looks_through(self, **senses):
        """Build the arm with these attributes, which name resources of the machine."""
        quick = {"speed_degs_per_sec": 180, "acceleration_degs_per_sec_per_sec": 500}
        valid = await self.module.validate(ARM, SIMULATED, quick | senses, "arm")
        used = [*valid.dependencies, *valid.optional_dependencies]
        self.arm = await self.module.add(ARM, SIMULATED, quick | senses, "arm", dependencies=used)

    async def moved(self, call):
        """Move, and note where the arm rests then."""
        await in_the_end(call)
        angles = (await self.arm.get_joint_positions()).values
        self.q = np.radians(angles)

    async def turn(self, *q_deg):
        await self.moved(lambda: self.arm.move_to_joint_positions(JointPositions(values=q_deg)))

    async def go(self, *xyz):
        x, y, z = xyz
        await self.moved(lambda: self.arm.move_to_position(Pose(x=x, y=y, z=z, o_z=1)))

    async def tool_path_mm(self, *xyz):
        pose = dict(zip(("x", "y", "z"), xyz, strict=True), oZ=1)
        destination = {"referenceFrame": "arm_origin", "pose": pose}
        request = {"componentName": "arm", "destination": destination}
        preview = {"preview": json.dumps(request)}
        return (await in_the_end(lambda: self.motion.do_command(preview)))["preview"][
            "tool_path_mm"
        ]


def outside_the_box(tool_path_mm):
    """How far a path stays from the box [mm]; 0 when it enters."""
    away = np.abs(np.array(tool_path_mm) - BOX_MM) - SIZE_MM / 2.0
    return float(np.linalg.norm(np.maximum(away, 0.0), axis=1).min())


async def test_a_camera_in_the_hand_sees_what_is_in_the_way_wherever_the_arm_stands():
    async with Bench().running() as bench:
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
        assert outside_the_box(await bench.tool_path_mm(130, 220, 120)) > 3.0
        await bench.go(130, 220, 120)
        assert bench.camera.looks >= 6
        with pytest.raises(GRPCError, match="'camera'"):
            await bench.go(*BOX_MM)

        # Were the arm not cut out, it would be an obstacle: it is where it is taken for another.
        bench.T_wrong = SE3.from_translation((0.08, 0.0, 0.0))
        with pytest.raises(GRPCError, match="'camera'"):
            await bench.go(220, 30, 120)
