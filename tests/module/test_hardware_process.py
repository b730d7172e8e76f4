"""The real executable moves servos on a real port; they are emulated in another process.

With ``--hardware PORT`` the servos are those of an arm: its pan moves by 8 deg from where it
stands, its wrist rolls by 10, and its jaw opens and closes. Clear its surroundings first.
"""

import asyncio
import signal
import sys

import pytest
import pytest_asyncio
from grpclib import GRPCError
from grpclib.exceptions import StreamTerminatedError
from harness.emulated_port import HardwarePort, emulated_port, works
from harness.fake_parent import (
    ARM,
    GRIPPER,
    HARDWARE_ARM,
    HARDWARE_GRIPPER,
    ROOT,
    running_module,
    until,
)
from viam.components.arm import JointPositions

from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.registers import PRESENT_POSITION, TORQUE_ENABLE, TORQUE_LIMIT
from so101_motion.drivers.port.serial_port import SerialPort

pytestmark = pytest.mark.asyncio(loop_scope="module")

PATIENCE = 1.0
"""How long an answer of emulated servos may take on a busy machine [s]."""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def emulated(tmp_path_factory):
    """Servos that may be troubled; each test leaves them in reach of where they were."""
    async with emulated_port(tmp_path_factory.mktemp("port")) as emulated:
        yield emulated


@pytest.fixture
def bench(arm_port, request):
    """Servos of either kind."""
    return HardwarePort(arm_port) if arm_port else request.getfixturevalue("emulated")


def servos(port):
    """Torque, torque limit and place of each servo, once nobody else has the port."""
    bus = Bus(SerialPort(port), reply_timeout=PATIENCE)
    try:
        return [
            tuple(bus.read(i, row) for row in (TORQUE_ENABLE, TORQUE_LIMIT, PRESENT_POSITION))
            for i in range(1, 7)
        ]
    finally:
        bus.close()


async def joints(arm):
    return list((await arm.get_joint_positions()).values)


async def test_a_killed_module_leaves_the_arm_holding(bench):
    async with running_module() as (module, _, _):
        arm = await module.add(ARM, HARDWARE_ARM, {"port": bench.port}, "arm")
        await until(lambda: works(arm.get_geometries))
        await asyncio.sleep(1.0)
        start = await joints(arm)
        module.process.kill()
        await module.ended()
    async with running_module() as (module, _, _):
        arm = await module.add(ARM, HARDWARE_ARM, {"port": bench.port}, "arm")
        await until(lambda: works(arm.get_geometries))
        assert await joints(arm) == pytest.approx(start, abs=1.5)


async def test_a_terminated_module_stops_the_arm_and_leaves_it_holding(emulated):
    async with running_module() as (module, _, _):
        slow = {"port": emulated.port, "speed_degs_per_sec": 10}  # it is under way for 8 s
        arm = await module.add(ARM, HARDWARE_ARM, slow, "arm")
        await until(lambda: works(arm.get_geometries))
        start = await joints(arm)
        goal = JointPositions(values=[start[0] + 80.0, *start[1:]])
        move = asyncio.ensure_future(arm.move_to_joint_positions(goal))

        async def is_under_way():
            return (await joints(arm))[0] > start[0] + 8.0

        await until(is_under_way)
        module.process.send_signal(signal.SIGTERM)
        assert await module.ended() == 0
        with pytest.raises((GRPCError, StreamTerminatedError, ConnectionError)):
            await move
    here = servos(emulated.port)
    await asyncio.sleep(0.5)
    after = servos(emulated.port)

    assert [torque for torque, _, _ in after] == [1] * 6
    assert [place for _, _, place in after] == pytest.approx([place for _, _, place in here], abs=8)
    assert after[0][2] - 2048 < 60.0 * 4096 / 360, "it did not go on to its goal"


async def test_an_arm_is_let_go_of_if_asked_for_at_the_end_of_the_process_but_not_of_its_component(
    emulated,
):
    attributes = {"port": emulated.port, "at_end": "release"}
    async with running_module() as (module, _, _):
        arm = await module.add(ARM, HARDWARE_ARM, attributes, "arm")
        await until(lambda: works(arm.get_geometries))
        await arm.stop()
        await module.remove(ARM, "arm")
        assert [torque for torque, _, _ in servos(emulated.port)] == [1] * 6

        arm = await module.add(ARM, HARDWARE_ARM, attributes, "arm")
        gripper = await module.add(GRIPPER, HARDWARE_GRIPPER, {"port": emulated.port}, "gripper")
        for one in (arm, gripper):
            await until(lambda one=one: works(one.get_geometries))
        await arm.stop()
        module.process.send_signal(signal.SIGTERM)
        assert await module.ended() == 0
    assert [torque for torque, _, _ in servos(emulated.port)] == [0] * 6


GUIDE_AND_END = """
import sys
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.port_settings import ServoSettings

rig = open_hardware(ServoSettings(port=sys.argv[1]).with_arm((1, 2, 3, 4, 5)))
rig.arm.set_manual(True)
"""


async def test_a_program_that_just_ends_leaves_the_arm_holding(emulated):
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", GUIDE_AND_END, emulated.port, cwd=ROOT
    )
    assert await asyncio.wait_for(process.wait(), 60.0) == 0
    found = servos(emulated.port)

    assert [torque for torque, _, _ in found] == [1] * 6
    assert [limit for _, limit, _ in found] == [1000] * 5 + [500]
