"""Components whose servos do not answer at configuration, in the real module process.

They exist at once, name the silent servos, delay no other component, and work when the servos
answer.
"""

import asyncio
import os
import signal
import termios
import time
import tty

import pytest
from grpclib import Status
from harness.emulated_port import emulated_port, patiently, works
from harness.fake_parent import (
    ARM,
    GRIPPER,
    HARDWARE_ARM,
    HARDWARE_GRIPPER,
    SIMULATED,
    running_module,
    until,
)
from harness.in_process_module import refused
from viam.components.arm import JointPositions

from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.port.serial_port import SerialPort

pytestmark = pytest.mark.emulator_only

PATIENT = {"timeout": "60s"}
"""For how long a component that waited for silent servos would keep everybody waiting."""

AT_ONCE = 30.0
"""Within what time a component must be there [s]; mostly 0.02, on a busy machine some seconds."""


@pytest.fixture
async def emulated(tmp_path):
    """Servos of which one is dead."""
    async with emulated_port(tmp_path) as emulated:
        await emulated.fault("dead:3")
        yield emulated


@pytest.fixture
async def module():
    async with running_module() as (module, _, _):
        yield module


@pytest.fixture
def empty_port():
    """A port on which nobody ever answers."""
    ours, theirs = os.openpty()
    tty.setraw(theirs, termios.TCSANOW)
    yield os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


async def within(seconds, call):
    """What a call returns, which must come soon."""
    begin = time.monotonic()
    answer = await call
    assert time.monotonic() - begin < seconds
    return answer


async def names(component, joint):
    """Wait until the servo of a joint is said to be the silent one; a busy machine may keep all
    of them from answering at first."""

    async def is_named():
        return joint in (await component.get_status())["not_ready"]

    await until(is_named)


async def test_an_arm_is_there_before_its_servos_and_says_who_is_silent(emulated, module):
    attributes = {"port": emulated.port, **PATIENT}
    arm = await within(AT_ONCE, module.add(ARM, HARDWARE_ARM, attributes, "arm"))
    before = await arm.get_kinematics()
    await names(arm, "elbow_flex")
    for call in (
        arm.get_joint_positions(),
        arm.get_end_position(),
        arm.move_to_joint_positions(JointPositions(values=[0.0] * 5)),
        arm.do_command({"command": "ping"}),
        arm.do_command({"command": "get_calibration"}),
    ):
        says = ("not ready", "no reply from servo 3 (elbow_flex)", "tried for ")
        await within(AT_ONCE, refused(call, Status.UNAVAILABLE, *says))
    await arm.stop()
    status = await arm.get_status()
    assert status["connected"] is False
    assert "elbow_flex" in status["not_ready"]
    assert "elbow_flex" in status["notes"][0]
    assert "elbow_flex" in (await arm.do_command({"command": "diagnose"}))["error"]

    await emulated.fault("end dead:3")
    await until(lambda: works(arm.get_geometries))
    status = await arm.get_status()
    assert "not_ready" not in status
    assert status["notes"] == []
    assert status["state"] == "holding"
    start = list((await arm.get_joint_positions()).values)
    goal = [start[0] + 5.0, *start[1:]]
    await patiently(lambda: arm.move_to_joint_positions(JointPositions(values=goal)))
    assert list((await arm.get_joint_positions()).values) == pytest.approx(goal, abs=0.5)
    assert await arm.get_kinematics() == before


async def test_a_stop_of_another_arm_does_not_wait_for_silent_servos(
    emulated, empty_port, tmp_path_factory, module
):
    async with emulated_port(tmp_path_factory.mktemp("healthy")) as healthy:
        slow = {"port": healthy.port, "speed_degs_per_sec": 3.0}  # under way for AT_ONCE
        arm = await module.add(ARM, HARDWARE_ARM, slow, "arm")
        await until(lambda: works(arm.get_joint_positions))
        start = list((await arm.get_joint_positions()).values)
        goal = JointPositions(values=[start[0] + 90.0, *start[1:]])
        move = asyncio.ensure_future(arm.move_to_joint_positions(goal))

        async def is_under_way():
            return (await arm.get_joint_positions()).values[0] > start[0] + 1.0

        await until(is_under_way)
        for name, port in (("silent", empty_port), ("dead", emulated.port)):
            attributes = {"port": port, **PATIENT}
            await within(AT_ONCE, module.add(ARM, HARDWARE_ARM, attributes, name))
        await within(AT_ONCE, arm.stop())
        await refused(move, Status.CANCELLED)
        assert (await arm.get_joint_positions()).values[0] < start[0] + 70.0


async def test_a_component_that_is_still_connecting_is_removed_at_once(empty_port):
    async with running_module() as (module, _, _):
        attributes = {"port": empty_port, **PATIENT}
        await module.add(ARM, SIMULATED, {}, "other")  # keeps the planning process
        for _ in range(2):
            arm = await module.add(ARM, HARDWARE_ARM, attributes, "arm")
            gripper = await module.add(GRIPPER, HARDWARE_GRIPPER, attributes, "gripper")
            for component in (arm, gripper):
                await refused(component.get_geometries(), Status.UNAVAILABLE, "no servo answers")
                assert "no servo answers" in (await component.get_status())["not_ready"]
            await within(AT_ONCE, module.remove(ARM, "arm"))
            await within(AT_ONCE, module.remove(GRIPPER, "gripper"))
            Bus(SerialPort(empty_port)).close()  # somebody else may have the port
        await module.add(ARM, HARDWARE_ARM, attributes, "arm")
        module.process.send_signal(signal.SIGTERM)
        assert await module.ended() == 0
    Bus(SerialPort(empty_port)).close()
