"""``so101 teleop`` as people start it, and what is left when a process is killed.

The follower's servos are in this process, so that the test can read their true joints; the leader's
are in a process of their own, with a hand that sways its base.
"""

import asyncio
import math
import signal
import sys
import time

import pytest
from harness.fake_parent import ROOT, until

from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.pty_port import Pacing
from so101_motion.planning.kinematics.model import RobotModel

SO101 = "from so101_motion.cli import main; main()"
HEAVY = ("shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


def swaying(seconds=120.0):
    """A hand holds the leader up and sways its base, 30 deg to and fro every 2.5 s."""
    lines = [f"0 {joint} start" for joint in ("shoulder_pan", *HEAVY)]
    for k in range(round(seconds / 0.02)):
        q = 30.0 * math.sin(2.0 * math.pi * k * 0.02 / 2.5)
        lines.append(f"{1.0 + 0.02 * k:.2f} shoulder_pan {q:.3f}")
    return "\n".join(lines)


async def so101(*arguments, **pipes):
    return await asyncio.create_subprocess_exec(
        sys.executable, "-c", SO101, *map(str, arguments), cwd=ROOT, **pipes
    )


class Lines:
    """What a process says, as it says it."""

    def __init__(self, stream):
        self.said = []
        self._task = asyncio.ensure_future(self._read(stream))

    async def _read(self, stream):
        async for line in stream:
            self.said.append(line.decode().strip())

    def has(self, word):
        return any(word in line for line in self.said)

    async def end(self):
        await self._task


class Scene:
    """A leader in a process of its own, a follower here."""

    def __init__(self, folder):
        self.folder = folder
        self.follower = Emulator(
            EmulatorOptions(
                link=folder / "follower",
                hand="\n".join(f"0 {joint} start" for joint in HEAVY),
                pacing=Pacing(realtime=True),
            ),
            gravity=RobotModel.load().gravity_torque,
        )
        self.processes = []

    async def begin(self):
        (self.folder / "hand").write_text(swaying())
        self.leader = await so101(
            "emulate", "--realtime",
            "--link", self.folder / "leader", "--hand", self.folder / "hand",
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE,
        )  # fmt: skip
        await self.leader.stdout.readline()
        self.processes.append(self.leader)

    async def teleop(self, *options):
        process = await so101(
            "teleop", "--leader", self.folder / "leader", "--follower", self.folder / "follower",
            "--no-gripper", "--yes", *options,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        self.processes.append(process)
        lines = Lines(process.stderr)
        await until(lambda: lines.has("mirroring"))
        return process, lines

    @property
    def pan_deg(self):
        self.follower.advance()
        return math.degrees(self.follower.world.q[0])

    async def speed_deg(self, over=0.05):
        """How fast the follower's base truly turns [deg/s]."""
        before, begin = self.pan_deg, time.monotonic()
        await asyncio.sleep(over)
        return abs(self.pan_deg - before) / (time.monotonic() - begin)

    async def is_swaying(self):
        return await self.speed_deg() > 40.0

    async def has_settled(self):
        return await self.speed_deg(0.2) < 12.0

    async def end(self):
        for process in self.processes:
            if process.returncode is None:
                process.send_signal(signal.SIGTERM)
                await asyncio.wait_for(process.wait(), 60.0)
        self.follower.close()


@pytest.fixture
async def scene(tmp_path):
    scene = Scene(tmp_path)
    await scene.begin()
    yield scene
    await scene.end()


async def test_killing_the_program_leaves_the_follower_at_rest(scene):
    process, _ = await scene.teleop()
    await until(scene.is_swaying)
    process.kill()
    await process.wait()
    await until(scene.has_settled)
    where = scene.pan_deg

    again, lines = await scene.teleop()
    await until(scene.is_swaying)
    assert abs(where) < 45.0
    again.send_signal(signal.SIGINT)
    await until(lambda: lines.has("ended by Ctrl-C; the arm on"))
    assert await asyncio.wait_for(again.wait(), 60.0) == 130
