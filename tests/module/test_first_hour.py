"""From a box of parts to a moving arm, with the commands of the newcomers' page and nothing else.

A simulated person does what the commands ask for: plugs cables, holds the arm up, leads the joints
to their stops.
"""

import asyncio
import json
import os
import re
import sys

import numpy as np
import pytest
from harness.emulated_port import patiently
from harness.fake_parent import ARM, GRIPPER, ROOT, running_module
from harness.held_calibration import put
from viam.proto.common import Pose

from so101_motion.calib.record.record import JOINTS
from so101_motion.common.state import ARM_JOINTS
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.faults import parse_fault
from so101_motion.drivers.emulator.joint_figures import SO101
from so101_motion.drivers.emulator.pty_port import Pacing
from so101_motion.planning.kinematics.model import RobotModel

SO101_COMMAND = (sys.executable, "-c", "from so101_motion.cli import main; main()")
TICKS_PER_DEG = 4096 / 360

PLUG_IN = r"connect only the motor of (\w+),"
"""What ``setup`` says, and what a person does then."""


class Newcomer:
    """Somebody with a kit on the table, and a terminal."""

    def __init__(self, kit, home):
        self.kit = kit
        self._hand = None
        self._env = {**os.environ, "XDG_DATA_HOME": str(home), "SO101_PORT": kit.port}

    def does(self, what):
        """What could be typed into ``so101 emulate`` as well."""
        self.kit.begin(parse_fault(what))

    async def plugs(self, joint):
        self.does(f"only:{joint}")

    async def sweeps(self):
        """Lead the joints to their stops; again, if the command has not seen them all by then."""

        async def hand():
            while True:
                await self._sweep()
                await asyncio.sleep(7.0)  # after 3 s the command ends, or else after 10 s

        self._hand = asyncio.ensure_future(hand())

    async def _sweep(self):
        """All joints at once to both their stops, which only an emulated hand can do."""
        self.kit.end(parse_fault("pose"))
        lower, upper = [0.0] * 40, [1.0] * 40  # a busy machine may look elsewhere for a while
        shares = [*np.linspace(0.5, 0.0, 20), *lower, *np.linspace(0.0, 1.0, 40), *upper]
        for share in [*shares, *np.linspace(1.0, 0.5, 20)]:
            put(self.kit.world, share)
            await asyncio.sleep(0.015)
        self.does("pose")

    async def runs(self, *arguments, then=()):
        """A command to its end; ``then`` says what is done as soon as it says something."""
        command = await asyncio.create_subprocess_exec(
            *SO101_COMMAND, *arguments, cwd=ROOT, env=self._env,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        said = []
        async for line in command.stderr:
            said.append(line.decode())
            for words, reaction in then:
                if match := re.search(words, said[-1]):
                    await reaction(*match.groups())
        output = (await command.stdout.read()).decode()
        if self._hand is not None:
            self._hand.cancel()
        assert await command.wait() == 0, "".join(said)
        return json.loads(output)

    async def chains(self):
        self.does("chain")

    async def holds_up(self):
        self.does("pose")


@pytest.fixture
def person(tmp_path):
    options = EmulatorOptions(
        link=tmp_path / "so101",
        ids=dict.fromkeys(range(1, 7), 1),
        loose=True,
        calibrated=False,
        pacing=Pacing(realtime=True),
    )
    with Emulator(options) as kit:  # without weight, or it would sink while the hand is elsewhere
        yield Newcomer(kit, tmp_path / "home")


def true_deg(joint, entry, ticks):
    """The angle of the emulated joint when its servo reads ``ticks`` [deg]."""
    return (ticks + entry["homing_offset"] - joint.zero_ticks) / TICKS_PER_DEG


def check_calibration(told):
    for joint in SO101:
        entry = told["calibration"][joint.name]
        ends = [true_deg(joint, entry, entry[end]) for end in ("range_min", "range_max")]
        stops = [angle * 57.29578 for angle in (joint.lower, joint.upper)]
        assert ends == pytest.approx(stops, abs=3.0 / TICKS_PER_DEG), joint.name
    for joint in SO101[: len(ARM_JOINTS)]:
        entry = told["calibration"][joint.name]
        middle = true_deg(joint, entry, (entry["range_min"] + entry["range_max"]) / 2)
        assert told["zeros"][joint.name]["middle_deg"] == pytest.approx(middle, abs=0.5)


def added(module, api, configured):
    one = configured[api]
    return module.add(api, one["model"], one["attributes"], one["name"])


@pytest.mark.long  # half a minute of real time, in which a hand must be quick enough
async def test_a_newcomer_gets_from_a_box_of_parts_to_a_moving_arm(person):
    told = await person.runs(
        "setup", "--yes", "--within", "100", "--json",
        then=((PLUG_IN, person.plugs), ("Put all six", person.chains)),
    )  # fmt: skip
    assert told["ok"]
    assert [motor["joint"] for motor in told["motors"]] == list(reversed(JOINTS))

    told = await person.runs(
        "calibrate", "--yes", "--json",
        then=(("Hold every joint", person.holds_up), ("Move every joint", person.sweeps)),
    )  # fmt: skip
    assert told["holds"]
    check_calibration(told)
    person.kit.end(parse_fault("pose"))
    file = told["file"]

    told = await person.runs("viam", "config", "--json")
    configured = {one["api"]: one for one in told["configuration"]["components"]}
    assert configured[ARM]["attributes"] == {"port": person.kit.port, "calibration_file": file}
    async with running_module() as (module, _, _):
        arm = await patiently(lambda: added(module, ARM, configured))
        gripper = await patiently(lambda: added(module, GRIPPER, configured))
        goal = Pose(x=250.0, y=80.0, z=150.0, o_z=1.0)
        await patiently(lambda: arm.move_to_position(goal))
        with person.kit.world.lock:
            p = RobotModel.load().frame(person.kit.world.q[:5], "tool").p
        assert 1000.0 * p == pytest.approx((250.0, 80.0, 150.0), abs=5.0), "where it truly is"
        await patiently(gripper.open)
