"""How many functions of ours a request passes through; ``pytest -s`` prints them in order."""

import concurrent.futures
import os
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from harness.emulated_rig import ModelBench, arm_client
from viam.components.arm import Pose

import so101_motion
from so101_motion.planning.goals import JointGoal
from so101_motion.viam.models.calibration import So101Calibration

PACKAGE = str(Path(so101_motion.__file__).parent) + os.sep
PLANNING = "(planning, in a process of its own)"

KEPT_BY = ("ChannelPlayer.begin", "ChannelPlayer.turn", "PlannedMotion.sample")
"""What a motion that begins is left to, and what makes its setpoints."""

NOT_THE_MODULE = ("drivers/emulator/", "common/clock.py")
"""Ours, but no part of a walk: the servos' side, and what lets the simulated time pass."""

_C_CALLS = frozenset({"put", "send", "write", "start_new_thread"})
_CALLS = frozenset(
    {
        concurrent.futures.Future.set_result.__code__,
        concurrent.futures.Future.set_exception.__code__,
        threading.Event.set.__code__,
    }
)


class HopCounter:
    """Counts the functions of ours that a request passes through.

    A profile function (``sys.setprofile``) looks at a thread's stack whenever the thread hands the
    request on: to another thread (a queue, an event, a future), to the planning process, or to the
    port, or keeps it for the next tick (``KEPT_BY``). The functions of this package on those
    stacks, each counted once, are the hops. A function that returns before its caller hands the
    request on is none. The inside of the planning process counts as one.

    Make one before the threads that it shall look at are started.
    """

    def __init__(self):
        self.hops, self.is_complete = [], False
        self._last, self._but, self._is_on = "", (), False
        threading.setprofile(self._profile)
        self.look_here()

    def look_here(self, *_):
        """Look at the present thread, too; as a callback, at the one that calls it."""
        sys.setprofile(self._profile)

    def start(self, last, but=()):
        """Count from now until ``last``; leave out stacks with a function of ``but``."""
        self._last, self._but, self._is_on = last, ("ServoDriver.read", *but), True

    def close(self):
        self._is_on = False
        threading.setprofile(None)
        sys.setprofile(None)

    def _profile(self, frame, event, called):
        if not self._is_on:
            return
        if event == "c_call":
            hands_on = called.__name__ in _C_CALLS
        else:
            code = frame.f_code
            kept = code.co_qualname in KEPT_BY or code.co_qualname == self._last
            hands_on = event == "call" and (kept or code in _CALLS)
        if not hands_on:
            return
        stack = functions_on(frame)
        if not stack or any(each.endswith(self._but) for each in stack):
            return
        self.hops += [each for each in stack if each not in self.hops]
        if stack[-1] == "arm/plan_messages MessageSocket.send" and PLANNING not in self.hops:
            self.hops.append(PLANNING)
        if stack[-1].endswith(self._last):
            self._is_on, self.is_complete = False, True


def functions_on(frame):
    """Our functions on a stack, the outermost first."""
    found = []
    while frame is not None:
        code, frame = frame.f_code, frame.f_back
        file = code.co_filename.partition(PACKAGE)[2]
        if file and not file.startswith(NOT_THE_MODULE):
            name = code.co_qualname.replace(".<locals>", "")
            found.append(f"{file.removesuffix('.py')} {name}")
    return found[::-1]


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
