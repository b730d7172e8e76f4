"""Each fault of an arm, through a real module process and over gRPC.

The call under way ends with an error that names the cause; once that is gone the next call works.
Servos are emulated; a hand holds the arm.
"""

import asyncio
from contextlib import asynccontextmanager
from dataclasses import KW_ONLY, dataclass

import numpy as np
import pytest
import pytest_asyncio
from grpclib import GRPCError, Status
from harness.emulated_port import emulated_port, patiently
from harness.fake_parent import (
    ARM,
    GRIPPER,
    HARDWARE_ARM,
    HARDWARE_GRIPPER,
    running_module,
    until,
)
from viam.components.arm import JointPositions

from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.port.serial_port import SerialPort

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.emulator_only]
FAST = {"speed_degs_per_sec": 80.0, "acceleration_degs_per_sec_per_sec": 400.0}
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


COASTING = 14.0
"""How far a joint at 80 deg/s goes from where it was last seen to where it stands [deg]: 10, by its
lag and its braking distance."""

SETTLING = 1.5
"""How far a joint may still go after an abrupt stop, back to where it was told to stand [deg]: up
to 1.2 at 80 deg/s, depending on where in its period the servo is caught."""

NO_JUMP = [0.5, 1.0, 1.0, 1.0, 0.5]
"""How far joints may move by themselves [deg]: less than half a degree, but for those whose weight
the hand and the servo share, which may slip."""


@dataclass(frozen=True)
class Row:
    """A fault and what is made of it.

    Attributes:
        name: What a person would call it.
        begins: What is typed into the emulator; ``ends``: the same when it is over.
        status: What the move under way ends with.
        says: Words its message must have.
        lasts: How long it goes on after that [s].
        silent: Servos that do not answer meanwhile; all others must.
        limp: Whether joints may sag meanwhile, for there is no power.
    """

    name: str
    begins: str
    ends: str
    status: Status
    says: tuple[str, ...]
    _: KW_ONLY
    lasts: float = 0.1
    silent: tuple[str, ...] = ()
    limp: bool = False


CABLE = ("wrist_flex", "wrist_roll", "gripper")

TABLE = (
    Row(
        "unplugged", "unplug", "end unplug",
        Status.UNAVAILABLE, ("the port went away", "USB cable"), lasts=2.0, silent=JOINTS,
    ),
    Row(
        "hot servo", "hot:elbow_flex=68", "hot:elbow_flex=30",
        Status.ABORTED, ("elbow_flex", "68 degC", "let it cool"),
    ),
    Row(
        "dead servo", "dead:wrist_roll", "end dead:wrist_roll",
        Status.UNAVAILABLE, ("wrist_roll", "no reply"), silent=("wrist_roll",),
    ),
    Row(
        "cable out in the middle",
        "\n".join(f"dead:{joint}" for joint in CABLE),
        "\n".join(f"end dead:{joint}" for joint in CABLE),
        Status.UNAVAILABLE, (*CABLE, "the cable between servos 3 and 4"), silent=CABLE, limp=True,
    ),
    Row(
        "brown-out", "brownout=3.4", "end brownout=3.4",
        Status.UNAVAILABLE, ("no servo answers", "power supply"), silent=JOINTS, limp=True,
    ),
    Row(
        "reboot", "reboot:shoulder_lift", "", Status.UNAVAILABLE, ("shoulder_lift",),
        silent=("shoulder_lift",), limp=True,  # silent for the better part of a second
    ),
    Row(
        "supply too low", "brownout=5.0", "end brownout=5.0",
        Status.ABORTED, ("gets only ", "switch the arm's power supply on"), limp=True,
    ),
    Row(
        "supply too high", "brownout=14.8", "end brownout=14.8",
        Status.ABORTED, ("supply outside its limits", "check the power supply"),
    ),
)  # fmt: skip


class Bench:
    """The module's arm and gripper, and the emulated servos under them."""

    def __init__(self, emulated, arm, gripper):
        self.type, self.arm, self.gripper = emulated.fault, arm, gripper

    async def joints(self):
        return np.array((await self.arm.get_joint_positions()).values)

    async def health(self):
        return (await self.arm.get_status())["health"]

    async def go(self, q_deg):
        await self.arm.move_to_joint_positions(JointPositions(values=list(map(float, q_deg))))

    @asynccontextmanager
    async def under_way(self, start, degrees=100.0):
        """A move of the pan joint that is well under way, and has far to go."""
        there = start[0] + (degrees if start[0] <= 0.0 else -degrees)  # within the limits
        move = asyncio.ensure_future(self.go([there, *start[1:]]))

        async def has_begun():
            return move.done() or abs((await self.joints())[0] - start[0]) > 5.0

        await until(has_begun)
        try:
            yield move
        finally:
            await asyncio.wait([move])

    async def is_well(self):
        status = await self.arm.get_status()
        health = status["health"]
        return (
            status["connected"]
            and not status["alarms"]
            and len(health) == 6
            and not any(one["silent"] or one["faults"] for one in health.values())
        )


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("faults")
    async with emulated_port(folder) as emulated:
        careful_gripper(emulated.port)
        async with running_module() as (module, _, _):
            attributes = {"port": emulated.port, **FAST}
            arm = await module.add(ARM, HARDWARE_ARM, attributes, "arm")
            gripper = await module.add(GRIPPER, HARDWARE_GRIPPER, {"arm": "arm"}, "gripper")
            yield Bench(emulated, arm, gripper)


@pytest_asyncio.fixture(loop_scope="module")
async def start(bench):
    """Where a test finds the arm once all is well [deg]."""
    await until(bench.is_well)
    return await bench.joints()


def careful_gripper(port):
    """As another program left it: a gripper that gives up at a fifth of its drive, and soon."""
    bus = Bus(SerialPort(port), reply_timeout=1.0)  # a busy machine may be late
    bus.store(6, {reg.OVERLOAD_TORQUE: 20, reg.PROTECTION_TIME: 100})
    bus.close()


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.name)
async def test_a_fault_is_named_costs_nothing_else_and_is_over_when_it_is_over(bench, row, start):
    try:
        await the_move_ends_with_it(bench, row, start)
        await others_are_read(bench, row.silent)
        stopped = await bench.joints()
        await asyncio.sleep(row.lasts)
    finally:
        await bench.type(row.ends)
    await until(bench.is_well)
    await others_are_read(bench)  # what joints() says is no older than that
    if not row.limp:
        back = await bench.joints()
        seen = "shoulder_pan" not in row.silent  # unseen, it comes to rest after the last look
        most = [SETTLING if seen else COASTING, *[SETTLING] * 4]  # the pan alone was moving
        assert np.all(np.abs(back - stopped) < most), "it held"
        await asyncio.sleep(0.5)
        assert np.all(np.abs(await bench.joints() - back) < NO_JUMP), "no jump"
    await bench.go(start)
    assert await bench.joints() == pytest.approx(start, abs=0.5)


async def the_move_ends_with_it(bench, row, start):
    async with bench.under_way(start) as move:
        await bench.type(row.begins)
        with pytest.raises(GRPCError) as caught:
            await asyncio.wait_for(move, 60.0)
    assert caught.value.status is row.status
    for words in row.says:
        assert words in caught.value.message


async def others_are_read(bench, silent=()):
    """All servos but those that may be silent go on answering."""
    before = await bench.health()

    async def they_are():
        now = await bench.health()
        more = {joint for joint in JOINTS if now[joint]["answers"] > before[joint]["answers"] + 2}
        quiet = {joint for joint in JOINTS if now[joint]["silent"]}
        return more >= set(JOINTS) - set(silent) and quiet <= set(silent)

    await until(they_are)


async def test_an_overloaded_gripper_is_named_and_the_arm_goes_on(bench):
    await until(bench.is_well)
    await patiently(bench.gripper.open)
    await bench.type("object=0.03")
    assert await bench.gripper.grab() is True
    await bench.type("end object=0.03\nobject=0.06")  # it is forced open

    async def gives_up():
        return "gripper" in (await bench.arm.get_status())["alarms"]

    await until(gives_up)
    alarm = (await bench.arm.get_status())["alarms"]["gripper"]
    assert "overloaded" in alarm
    own = await bench.gripper.do_command({"command": "health"})
    assert own["faults"] == ["overload"]
    start = await bench.joints()
    await bench.go([start[0] - 5.0, *start[1:]])

    await bench.type("end object=0.06")
    await patiently(bench.gripper.open)
    await until(bench.is_well)
    own = await bench.gripper.do_command({"command": "health"})
    assert own["faults"] == []
    assert "overload" in own["faults_since_start"]


async def test_on_a_wire_that_loses_and_garbles_moves_complete(bench, start):
    before = await bench.health()
    await bench.type("loss=0.05\ncorrupt=0.02")
    try:
        for degrees in (15.0, 0.0):
            goal = [start[0] + degrees, *start[1:4], start[4] + 2.0 * degrees]
            await bench.go(goal)
            assert await bench.joints() == pytest.approx(goal, abs=0.5)
        await patiently(bench.gripper.open)
    finally:
        await bench.type("end loss=0.05\nend corrupt=0.02")
    after = await bench.health()
    for figure in ("lost", "corrupt"):
        assert sum(after[joint][figure] - before[joint][figure] for joint in JOINTS) > 5
    assert not any(one["silent"] for one in after.values())
