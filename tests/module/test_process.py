"""The real executable on a real socket; the test plays viam-server."""

import asyncio
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
import pytest_asyncio
from grpclib import GRPCError, Status
from grpclib.exceptions import StreamTerminatedError
from harness.emulated_port import emulated_port, works
from harness.fake_parent import (
    ARM,
    CALIBRATION,
    DISCOVERY,
    GRIPPER,
    HARDWARE_ARM,
    HARDWARE_GRIPPER,
    MOTION,
    ROOT,
    SIMULATED,
    SIMULATED_GRIPPER,
    FakeMotion,
    is_listening,
    running_module,
    until,
)
from harness.in_process_module import refused
from viam.components.arm import JointPositions, Pose
from viam.proto.common import (
    GeometriesInFrame,
    Geometry,
    PoseInFrame,
    RectangularPrism,
    Vector3,
    WorldState,
)
from viam.proto.robot import GetPoseRequest, RobotServiceStub
from viam.resource.manager import ResourceManager
from viam.services.motion import Motion
from viam.services.motion.service import MotionRPCService

from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.viam.models.module import LATER
from so101_motion.viam.models.registered import MODELS

SWEEP = [90.0, 0.0, 0.0, 0.0, 0.0]


def children_of(pid):
    threads = Path(f"/proc/{pid}/task").iterdir()
    return [int(word) for thread in threads for word in (thread / "children").read_text().split()]


def is_alive(pid):
    try:
        return read(pid, "stat").rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


async def gone(pid):
    await until(lambda: not is_alive(pid))


def read(pid, name):
    return Path(f"/proc/{pid}/{name}").read_text()


async def begin_sweep(arm, seconds=0.0):
    """A long move of the pan joint, under way; simulated time is helped along."""
    move = asyncio.ensure_future(arm.move_to_joint_positions(JointPositions(values=SWEEP)))

    async def has_begun():
        if seconds:
            await arm.do_command({"command": "advance_time", "seconds": seconds})
        return (await arm.get_joint_positions()).values[0] > 1.0

    await until(has_begun)
    return move


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def process():
    """A module for the tests that leave it as it was; the machine has a motion service."""
    service = FakeMotion()
    rpc = MotionRPCService(ResourceManager([service]))
    resources = [Motion.get_resource_name("mine")]
    async with running_module(services=[rpc], resources=resources) as (module, _, _):
        module.named_service = service
        yield module


shared = pytest.mark.asyncio(loop_scope="module")
"""These come first, one after the other: while other tests run, nobody answers the module, which
gives up its connection then."""


@shared
async def test_configurations_that_cannot_be_used_are_refused_before_anything_is_built(process):
    for api, model, attributes, says in [
        (ARM, SIMULATED, {"sped": 1.0}, 'did you mean "speed_degs_per_sec"?'),
        (ARM, SIMULATED, {"max_speed_degs_per_sec": 1000.0}, "from 3 to 180"),
        (GRIPPER, SIMULATED_GRIPPER, {"gripper_type": "leeder"}, 'did you mean "leader"?'),
    ]:
        for ask in (process.validate, process.add):
            error = await refused(ask(api, model, attributes), Status.INVALID_ARGUMENT, says)
            assert "GRPCError" not in error.message
            assert "line_num" not in error.message


@shared
async def test_two_arms_of_one_model_may_be_configured_at_the_same_time(process):
    for ask in (process.validate, process.add):
        await asyncio.gather(*(ask(ARM, SIMULATED, {}, name) for name in ("left", "right")))
    for name in ("left", "right"):
        await process.remove(ARM, name)


@shared
async def test_what_it_logs_reaches_the_parent(process):
    await process.add(ARM, SIMULATED, {"mesh_decimation_ratios": [0.5]}, "one")
    await process.add(ARM, SIMULATED, {}, "other")

    def lines():
        return [text for _, text in process.parent.lines if "mesh_decimation_ratios" in text]

    await until(lines)
    assert len(lines()) == 1


@shared
async def test_our_motion_service_asks_the_machine_where_the_arm_stands(process):
    arm = await process.add(ARM, SIMULATED, {"acceleration_degs_per_sec_per_sec": 500.0}, "arm")
    motion = await process.add(MOTION, "devrel:so101:motion", {}, "planner")
    above = PoseInFrame(reference_frame="world", pose=Pose(x=250, y=30, z=250, o_z=1))
    crate = Geometry(
        label="crate",
        box=RectangularPrism(dims_mm=Vector3(x=80, y=80, z=80)),
        center=Pose(x=250, y=30, z=140, o_z=1),
    )
    around = WorldState(obstacles=[GeometriesInFrame(reference_frame="world", geometries=[crate])])
    assert await motion.move("arm", above, around)
    pose = await arm.get_end_position()
    assert (pose.x, pose.y, pose.z) == pytest.approx((250, 30, 150), abs=0.2)
    below = PoseInFrame(reference_frame="world", pose=Pose(x=250, y=30, z=150, o_z=1))
    with pytest.raises(GRPCError, match="crate"):
        await motion.move("arm", below, around)


@shared
async def test_where_a_component_is_is_asked_on_the_modules_socket(process):
    """viam-server's client of a motion service sends the machine's GetPose there."""
    machine = RobotServiceStub(process.channel)
    request = GetPoseRequest(component_name="arm", destination_frame="world")
    answer = await machine.GetPose(request)
    assert (answer.pose.reference_frame, answer.pose.pose.x) == ("world", 391.4)
    await refused(
        machine.GetPose(GetPoseRequest(component_name="moon")),
        Status.NOT_FOUND,
        '"moon" not in frame system; give each a frame',
    )


@shared
async def test_a_named_motion_service_is_a_dependency_and_is_asked_through_the_parent(
    process, tmp_path
):
    """By a simulated arm and by a real one."""
    async with emulated_port(tmp_path) as emulated:
        for model, own in ((SIMULATED, {}), (HARDWARE_ARM, {"port": emulated.port})):
            attributes = {"motion": "mine", **own}
            answer = await process.validate(ARM, model, attributes)
            assert list(answer.dependencies) == ["rdk:service:motion/mine"]
            arm = await process.add(ARM, model, attributes, "moved", answer.dependencies)
            await until(lambda arm=arm: works(arm.get_geometries))  # found late on a busy machine
            await arm.move_to_position(Pose(x=250, y=0, z=150, o_z=1))
            await process.remove(ARM, "moved")
    calls = process.named_service.calls
    asked = [(name, there.reference_frame, extra) for name, there, extra in calls]
    assert asked == 2 * [("moved", "moved_origin", {"goal_metric_type": "position_only"})]


def test_what_only_the_planning_process_or_a_later_request_needs_is_not_imported_before_ready():
    later = (*LATER, "so101_motion.planning.planner", "so101_motion.planning.cell.together")
    program = (
        "import importlib, sys\n"
        "from so101_motion.viam.models.module import LATER\n"
        f"print([name for name in {later} if name in sys.modules])\n"
        "for name in LATER:\n"
        "    importlib.import_module(name)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout == "[]\n"


async def test_a_module_that_is_told_to_end_while_it_imports_ends_well():
    async with running_module() as (module, _, _):
        asked = asyncio.ensure_future(module.validate(ARM, HARDWARE_ARM, {"port": "/dev/none"}))
        await asyncio.sleep(0.1)
        module.process.send_signal(signal.SIGTERM)
        assert await module.ended() == 0
        await asyncio.wait([asked])
        assert not asked.cancelled()
        asked.exception()


async def test_a_session_from_the_handshake_to_the_end():
    """With ``run.sh``, which starts the module wherever it is called from."""
    run = {"command": (str(ROOT / "run.sh"),), "arguments": ("--log-level=info",), "cwd": "/"}
    async with running_module(**run) as (module, models, _):
        command_line = read(module.process.pid, "cmdline").split("\0")
        assert "so101_motion" in command_line, "it became the module, so signals reach it"
        assert "--log-level=info" in command_line
        assert models == {
            "arm": [HARDWARE_ARM, SIMULATED],
            "gripper": [HARDWARE_GRIPPER, SIMULATED_GRIPPER],
            "sensor": [CALIBRATION],
            "discovery": [DISCOVERY],
            "motion": ["devrel:so101:motion"],
            "generic": ["devrel:so101:teleop"],
            "world_state_store": ["devrel:so101:world-state"],
        }
        assert len(MODELS) == sum(map(len, models.values()))

        answer = await module.validate(ARM, SIMULATED, {})
        assert (list(answer.dependencies), list(answer.optional_dependencies)) == ([], [])
        arm = await module.add(ARM, SIMULATED, {"acceleration_degs_per_sec_per_sec": 500.0}, "arm")
        gripper = await module.add(GRIPPER, SIMULATED_GRIPPER, {}, "gripper")
        await asyncio.gather(arm.move_to_position(Pose(x=250, y=30, z=150, o_z=1)), gripper.open())
        pose = await arm.get_end_position()
        assert (pose.x, pose.y, pose.z) == pytest.approx((250, 30, 150), abs=0.2)

        maps = read(module.process.pid, "maps")
        assert "toppra" not in maps
        assert "matplotlib" not in maps
        (worker,) = children_of(module.process.pid)

        left = (await arm.get_joint_positions()).values
        await module.remove(ARM, "arm")
        await refused(arm.is_moving(), Status.NOT_FOUND)
        again = await module.add(ARM, SIMULATED, {}, "arm")
        stands = (await again.get_joint_positions()).values
        assert stands == pytest.approx(left, abs=0.01)  # as a real one would

        module.process.send_signal(signal.SIGTERM)
        assert await module.ended() == 0
        await gone(worker)


def preview_in_vain():
    """A plan to behind a wall, searched for longer than all else together takes."""
    x, y, z = 1e3 * RobotModel.load().frame(np.radians([-60.0, 0.0, 0.0, 0.0, 0.0])).p
    box = [("wall", (600, 20, 1200), (390, 0, 600)), ("roof", (1000, 1000, 20), (0, 0, 300))]
    geometries = [
        {
            "label": label,
            "box": {"dimsMm": dict(zip("xyz", size, strict=True))},
            "center": dict(zip("xyz", at, strict=True)),
        }
        for label, size, at in box
    ]
    destination = {"referenceFrame": "arm_origin", "pose": {"x": x, "y": y, "z": z, "oX": 1}}
    around = {"obstacles": [{"referenceFrame": "arm_origin", "geometries": geometries}]}
    return {
        "preview": {
            "componentName": "arm",
            "destination": destination,
            "worldState": around,
            "extra": {"timeout": 100},
        }
    }


async def test_abandoned_plans_and_frozen_time_hold_up_neither_the_next_move_nor_the_end():
    async with running_module() as (module, _, _):
        frozen = {"simulate_time": False}
        removed, kept = [
            await begin_sweep(await module.add(ARM, SIMULATED, frozen, name), seconds=0.05)
            for name in ("removed", "kept")
        ]
        await module.remove(ARM, "removed")
        with pytest.raises(GRPCError, match="ended early by the removal of its arm"):
            await removed
        arm = await module.add(ARM, SIMULATED, {"speed_degs_per_sec": 90.0}, "arm")
        motion = await module.add(MOTION, "devrel:so101:motion", {"arm": "arm"}, "planner")
        await arm.move_to_joint_positions(JointPositions(values=[60.0, 0.0, 0.0, 0.0, 0.0]))
        for number in (0, 1):
            plans = [asyncio.ensure_future(motion.do_command(preview_in_vain())) for _ in range(8)]
            done, _ = await asyncio.wait(plans, timeout=0.5)
            assert not done, "they are being searched for"
            async with asyncio.timeout(80.0):  # not the 100 s of one of them
                if number == 0:
                    for plan in plans:
                        plan.cancel()
                    await arm.move_to_joint_positions(JointPositions(values=[62.0, 0, 0, 0, 0]))
                else:
                    module.process.send_signal(signal.SIGTERM)
                    assert await module.ended() == 0
            await asyncio.gather(*plans, return_exceptions=True)
        with pytest.raises((GRPCError, StreamTerminatedError)):
            await kept


PARENT = """
import asyncio, sys
async def main():
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "so101_motion", sys.argv[1], stdout=asyncio.subprocess.DEVNULL
    )
    print(process.pid, flush=True)
    await asyncio.sleep(60)
asyncio.run(main())
"""


async def test_a_killed_parent_takes_the_module_and_its_worker_with_it():
    socket = Path(tempfile.gettempdir()) / f"so101-{os.getpid()}.sock"
    parent = await asyncio.create_subprocess_exec(
        sys.executable, "-c", PARENT, str(socket), cwd=ROOT, stdout=asyncio.subprocess.PIPE
    )
    pid = int(await parent.stdout.readline())
    await until(lambda: is_listening(socket))
    parent.kill()
    await parent.wait()

    await gone(pid)
    socket.unlink(missing_ok=True)


async def test_without_a_socket_it_says_how_it_is_meant():
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "so101_motion", stderr=asyncio.subprocess.PIPE, cwd=ROOT
    )
    _, complaint = await process.communicate()

    assert process.returncode != 0
    assert b"usage: python -m so101_motion SOCKET" in complaint
