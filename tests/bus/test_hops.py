"""How many functions of ours a request passes through; ``pytest -s`` prints them in order."""

import sys
from pathlib import Path

import numpy as np
import pytest
from harness.emulated_rig import ModelBench, arm_client
from harness.hop_counter import PLANNING, HopCounter
from viam.components.arm import Pose

from so101_motion.planning.goals import JointGoal
from so101_motion.viam.models.calibration import So101Calibration

MOST_FOR_A_MOVE = 26
MOST_FOR_A_STOP = 10
MOST_FOR_A_CALIBRATION_STEP = 10  # from the operation on

WALKS = (Path(__file__).parents[2] / "docs" / "architecture.md").read_text()
HOME = JointGoal(q=np.zeros(5))


@pytest.fixture
def counter():
    """Is there before the threads that it looks at."""
    counter = HopCounter()
    yield counter
    counter.close()


@pytest.fixture
async def bench(counter, tmp_path):
    bench = ModelBench(tmp_path)
    yield bench
    await bench.end()


def count(title, counter, first=""):
    """How many functions from the first whose name begins so; prints them."""
    assert counter.is_complete, counter.hops
    begin = next(i for i, hop in enumerate(counter.hops) if hop.startswith(first))
    hops = counter.hops[begin:]
    lines = [f"{title}: {len(hops)} functions"]
    lines += [f"{i:3d}  {hop}" for i, hop in enumerate(hops, 1)]
    sys.stdout.write("\n" + "\n".join(lines) + "\n")
    unnamed = [hop for hop in hops if hop.partition(" ")[2] not in WALKS]
    assert not unnamed, f"name them in docs/architecture.md: {unnamed}"
    return len(hops)


async def test_a_move_passes_few_functions_from_request_to_bytes(counter, bench):
    arm = bench.new_arm()
    async with arm_client(arm) as client:
        await bench.pass_time(1.0)
        # The planning process may be there from earlier tests, and the thread that talks to it.
        arm.rig.arm.start_plan(HOME).add_done_callback(counter.look_here)
        await bench.in_time(client.move_to_position(Pose(x=250, y=60, z=150, o_z=1)))
        counter.start("SerialPort.write")
        await bench.in_time(client.move_to_position(Pose(x=250, y=40, z=150, o_z=1)))

    assert PLANNING in counter.hops
    assert count("MoveToPosition", counter) <= MOST_FOR_A_MOVE


async def test_a_stop_passes_few_functions_until_the_arm_brakes(counter, bench):
    arm = bench.new_arm()
    async with arm_client(arm) as client:
        await bench.pass_time(1.0)
        move = client.move_to_position(Pose(x=250, y=160, z=150, o_z=1))
        moving = await bench.start(move, lambda: arm.rig.arm.is_moving)
        await bench.pass_time(0.5)
        counter.start(
            "ChannelPlayer._slow_down", but=["JointController.tick"]
        )  # the motion goes on meanwhile
        await bench.in_time(client.stop())
        with pytest.raises(Exception, match="stop"):
            await moving

    assert count("Stop", counter) <= MOST_FOR_A_STOP


async def test_a_calibration_step_passes_few_functions_from_request_to_bytes(
    counter, bench, tmp_path, monkeypatch
):
    monkeypatch.setenv("VIAM_MODULE_DATA", str(tmp_path))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    sensor = bench.new(So101Calibration, "calibration", port=str(bench.port))
    await sensor.do_command({"command": "start"})
    counter.start("SerialPort.write")
    await sensor.do_command({"command": "set_homing"})

    hops = count("Calibration step", counter, first="setup/")
    assert hops <= MOST_FOR_A_CALIBRATION_STEP
