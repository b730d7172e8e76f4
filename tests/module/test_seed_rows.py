"""What the published module promises of its arm and gripper, through a real module process.

The servos are those of ``so101 emulate``, or with ``--hardware PORT`` an arm's, which then moves by
8 deg from where it stands, its jaw all the way.
"""

import asyncio
from contextlib import asynccontextmanager

import numpy as np
import pytest
import pytest_asyncio
from grpclib import GRPCError, Status
from harness.emulated_port import HardwarePort, emulated_port, patiently, works
from harness.fake_parent import (
    ARM,
    GRIPPER,
    HARDWARE_ARM,
    HARDWARE_GRIPPER,
    running_module,
    until,
)
from harness.in_process_module import refused
from viam.components.arm import JointPositions, Pose

pytestmark = pytest.mark.asyncio(loop_scope="module")

STEP = 8.0
"""How far joints are moved [deg]."""

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


class Session:
    """An arm and its gripper in a module."""

    def __init__(self, module, port, arm, gripper):
        self.module, self.port, self.arm, self.gripper = module, port, arm, gripper

    async def joints(self):
        return np.array((await self.arm.get_joint_positions()).values)

    async def near(self, *shares):
        """A posture near the present one: shares of ``STEP``, each joint towards its middle."""
        q = await self.joints()
        return q - np.where(q > 0.0, 1.0, -1.0) * STEP * np.array(shares)

    async def go(self, q_deg):
        await patiently(lambda: self.arm.move_to_joint_positions(positions(q_deg)))

    async def ask(self, **request):
        return await self.arm.do_command(request)

    async def grip(self, **request):
        return await self.gripper.do_command(request)


def positions(q_deg):
    return JointPositions(values=list(map(float, q_deg)))


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def session(tmp_path_factory, arm_port):
    folder = tmp_path_factory.mktemp("rows")
    if arm_port:
        async with opened(HardwarePort(arm_port), {"speed_degs_per_sec": 20.0}) as session:
            yield session
        return
    async with (
        emulated_port(folder) as emulated,
        opened(emulated, {"acceleration_degs_per_sec_per_sec": 300.0}) as session,
    ):
        yield session


@asynccontextmanager
async def opened(port, attributes):
    """The module, with an arm and its gripper on a port."""
    async with running_module() as (module, _, _):
        arm = await module.add(ARM, HARDWARE_ARM, {"port": port.port, **attributes}, "arm")
        gripper = await module.add(GRIPPER, HARDWARE_GRIPPER, {"port": port.port}, "gripper")
        await until(lambda: works(arm.get_geometries))
        await port.let_go()
        await asyncio.sleep(1.0)  # the weight is taken up
        yield Session(module, port, arm, gripper)


# Configuration


async def test_dependencies_are_the_motion_service_and_the_gripper_s_arm(session):
    validate = session.module.validate
    answer = await validate(ARM, HARDWARE_ARM, {"port": "/dev/x", "motion": "planner"})
    assert any("planner" in one for one in answer.dependencies)
    answer = await validate(GRIPPER, HARDWARE_GRIPPER, {"arm": "left"})
    assert list(answer.dependencies) == ["left"]
    assert list((await validate(GRIPPER, HARDWARE_GRIPPER, {"port": "/dev/x"})).dependencies) == []
    with pytest.raises(GRPCError, match="port"):
        await validate(GRIPPER, HARDWARE_GRIPPER, {"gripper_type": "follower"})


async def test_a_second_component_that_contradicts_the_first_is_refused_with_the_difference(
    session,
):
    await refused(
        session.module.add(
            ARM, HARDWARE_ARM, {"port": session.port.port, "baudrate": 500000.0}, "other"
        ),
        Status.INVALID_ARGUMENT,
        "baudrate 1000000 and 500000",
    )
    await refused(
        session.module.add(ARM, HARDWARE_ARM, {"port": session.port.port + "-not-yet"}, "new"),
        Status.UNAVAILABLE,
        "no such port",
    )
    assert (await session.ask(command="controller_status"))["ref_count"] == 2


# Moving


@pytest.mark.emulator_only
@pytest.mark.parametrize(
    ("extra", "way"),
    [
        (None, (-15.0, 20.0, 15.0)),
        ({"goal_metric_type": "position_only"}, (10.0, -10.0, 10.0)),
        ({"goal_metric_type": "position_and_approach"}, (0.0, 0.0, 12.0)),
    ],
)
async def test_the_tool_goes_where_it_is_sent_as_much_of_the_pose_as_asked(session, extra, way):
    start = await session.joints()
    pose = await session.arm.get_end_position()
    o = {name: getattr(pose, name) for name in ("o_x", "o_y", "o_z", "theta")}
    goal = Pose(x=pose.x + way[0], y=pose.y + way[1], z=pose.z + way[2], **o)
    await patiently(lambda: session.arm.move_to_position(goal, extra=extra))
    there = await session.arm.get_end_position()
    assert (there.x, there.y, there.z) == pytest.approx((goal.x, goal.y, goal.z), abs=4.0)
    if extra == {"goal_metric_type": "position_and_approach"}:
        approach = np.dot([there.o_x, there.o_y, there.o_z], [goal.o_x, goal.o_y, goal.o_z])
        assert approach > np.cos(np.radians(2.0))
    await session.go(start)


# The arm's requests


async def test_servos_can_be_asked_after_in_every_way(session):
    ask = session.ask
    assert await ask(command="ping") == {"success": True}
    seen = await ask(command="test_servo_communication")
    assert (seen["success"], seen["arm_servo_ids"]) == (True, [1, 2, 3, 4, 5])
    assert np.degrees(seen["positions"]) == pytest.approx(await session.joints(), abs=0.5)
    status = await ask(command="controller_status")
    assert (status["ref_count"], status["has_controller"]) == (2, True)
    assert f"{session.port.port}@1000000(refs:2" in status["config"]
    found = await ask(command="diagnose")
    assert found["servos_found"] == [1, 2, 3, 4, 5, 6]
    assert isinstance(found["error"], str)
    verified = await ask(command="verify_config")
    assert verified == {"success": True, "error": ""}
    calibration = (await ask(command="get_calibration"))["calibration"]
    assert set(calibration) == set(JOINTS)
    assert set(calibration["elbow_flex"]) == {
        "id", "drive_mode", "homing_offset", "range_min", "range_max", "norm_mode",
    }  # fmt: skip
    answer = await ask(command="reload_calibration")
    assert answer["success"] is False, "there is no file"
    assert "calibration_file" in answer["error"]


# The gripper


async def test_the_gripper_opens_closes_and_tells_what_it_holds(session):
    call = asyncio.ensure_future(session.gripper.open())
    await until(lambda: session.gripper.is_moving())
    await call
    assert not await session.gripper.is_moving()
    opened = await session.grip(command="get_position")
    assert opened["position_percentage"] == pytest.approx(95.0, abs=3.0)
    assert await patiently(session.gripper.grab) is False
    closed = await session.grip(command="get_position")
    assert closed["position_percentage"] < 5.0
    assert not (await session.gripper.is_holding_something()).is_holding_something
