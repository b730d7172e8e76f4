"""Each fault of an arm, over gRPC, on emulated servos.

The call under way ends with an error that names the cause; once that is gone the next call works.
A hand holds the arm.
"""

from dataclasses import KW_ONLY, dataclass

import numpy as np
import pytest
from grpclib import Status
from harness.emulated_port import SUPPORT
from harness.emulated_rig import arm_client, gripper_client
from harness.in_process_module import refused
from viam.components.arm import JointPositions

from so101_motion.drivers.emulator import registers as emu
from so101_motion.drivers.emulator.faults import parse_fault

pytestmark = pytest.mark.emulated(hand=SUPPORT)
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
        Status.ABORTED, ("elbow_flex", "68 °C", "let it cool"),
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


class Faulty:
    """An arm and the emulated servos under it."""

    def __init__(self, models, arm):
        self.models, self.arm = models, arm

    def type(self, lines):
        """What could be typed into ``so101 emulate``."""
        for line in filter(None, lines.split("\n")):
            act = (
                self.models.emulator.end if line.startswith("end ") else self.models.emulator.begin
            )
            act(parse_fault(line.removeprefix("end ")))

    async def joints(self):
        return np.array((await self.arm.get_joint_positions()).values)

    async def health(self):
        return (await self.arm.get_status())["health"]

    def going(self, q_deg):
        return self.arm.move_to_joint_positions(JointPositions(values=list(map(float, q_deg))))

    async def is_well(self):
        status = await self.arm.get_status()
        health = status["health"]
        return (
            status["connected"]
            and not status["alarms"]
            and len(health) == 6
            and not any(one["silent"] or one["faults"] for one in health.values())
        )

    async def until(self, check):
        for _ in range(200):
            if await check():
                return
            await self.models.pass_time(0.1)
        raise AssertionError("it never came true")

    async def others_are_read(self, silent=()):
        """All servos but those that may be silent go on answering."""
        before = await self.health()
        await self.models.pass_time(0.2)
        now = await self.health()
        more = {joint for joint in JOINTS if now[joint]["answers"] > before[joint]["answers"] + 2}
        assert more >= set(JOINTS) - set(silent)
        assert {joint for joint in JOINTS if now[joint]["silent"]} <= set(silent)


@pytest.fixture
async def bench(models):
    async with arm_client(models.new_arm(**FAST)) as arm:
        await models.pass_time(1.0)
        yield Faulty(models, arm)


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.name)
async def test_a_fault_is_named_costs_nothing_else_and_is_over_when_it_is_over(bench, row):
    models, start = bench.models, await bench.joints()
    move = await models.start(
        bench.going([start[0] + 100.0, *start[1:]]), lambda: models.q_deg[0] > start[0] + 12.0
    )
    bench.type(row.begins)
    await refused(models.in_time(move), row.status, *row.says)
    await bench.others_are_read(row.silent)
    stopped = np.degrees(models.base.arm.state.q)  # a client is not told while it is unplugged
    await models.pass_time(row.lasts)
    bench.type(row.ends)
    await bench.until(bench.is_well)
    await bench.others_are_read()  # what joints() says is no older than that
    if not row.limp:
        back = await bench.joints()
        seen = "shoulder_pan" not in row.silent  # unseen, it comes to rest after the last look
        most = [SETTLING if seen else COASTING, *[SETTLING] * 4]  # the pan alone was moving
        assert np.all(np.abs(back - stopped) < most), "it held"
        await models.pass_time(0.5)
        assert np.all(np.abs(await bench.joints() - back) < NO_JUMP), "no jump"
    await models.in_time(bench.going(start))
    assert await bench.joints() == pytest.approx(start, abs=0.5)


async def test_an_overloaded_gripper_is_named_and_the_arm_goes_on(bench):
    """Another program left it to give up at a fifth of its drive, and soon."""
    models = bench.models
    servo = models.world.servo("gripper")
    for row, value in ((emu.OVERLOAD_TORQUE, 20), (emu.PROTECTION_TIME, 100)):
        servo.memory.keep(row, value)
    servo.boot()
    async with gripper_client(models.new_gripper()) as gripper:
        await models.in_time(gripper.open())
        bench.type("object=0.03")
        assert await models.in_time(gripper.grab()) is True
        bench.type("end object=0.03\nobject=0.06")  # it is forced open

        async def gives_up():
            return "gripper" in (await bench.arm.get_status())["alarms"]

        await bench.until(gives_up)
        assert "overloaded" in (await bench.arm.get_status())["alarms"]["gripper"]
        assert (await gripper.do_command({"command": "health"}))["faults"] == ["overload"]
        start = await bench.joints()
        await models.in_time(bench.going([start[0] - 5.0, *start[1:]]))

        bench.type("end object=0.06")
        await models.in_time(gripper.open())
        await bench.until(bench.is_well)
        own = await gripper.do_command({"command": "health"})
        assert own["faults"] == []
        assert "overload" in own["faults_since_start"]
