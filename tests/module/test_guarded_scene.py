"""What is not planned keeps off what the machine has, too: single targets and teleoperation."""

import asyncio
import logging
from contextlib import asynccontextmanager
from datetime import timedelta

import numpy as np
import pytest
from grpclib import GRPCError, Status
from harness.fake_machine import FakeMachine, Thing, a_box, hanging
from harness.fake_parent import config_of, until
from harness.in_process_module import advance, client_of, in_time, joints, new_arm, refused
from harness.setpoints import swing
from viam.components.arm import Arm

from so101_motion.common.units import to_rad
from so101_motion.planning.goals import JointGoal
from so101_motion.viam.conversion.frames import set_machine
from so101_motion.viam.models import teleop as teleop_module
from so101_motion.viam.models.teleop import So101Teleop

LEFT, RIGHT = (60.0, -45.0, 45.0, 60.0, 0.0), (-60.0, -45.0, 45.0, 60.0, 0.0)
CRATE = hanging("crate", geometry=a_box(400, 40, 400, x=300.0, z=200.0))
AT_THE_SIDE = hanging("crate", geometry=a_box(400, 40, 400), x=212.0, y=212.0, z=200.0, theta=45.0)
QUICK = {"speed_degs_per_sec": 90.0, "acceleration_degs_per_sec_per_sec": 400.0}


@pytest.fixture
async def machine(monkeypatch):
    """A machine with a crate between the left and the right of an arm."""
    monkeypatch.setattr(teleop_module, "_AGAIN", 0.01)
    yield FakeMachine(hanging("arm", joints=5), CRATE, things=[Thing("crate")])
    set_machine(lambda: None)


@asynccontextmanager
async def on_the_left(machine, **attributes):
    """An arm to the left of the crate, its client, and where its pan is [deg]."""
    set_machine(lambda: None)
    arm = new_arm(simulate_time=False, **QUICK, **attributes)
    async with client_of(arm) as client:

        async def pan():
            return (await client.get_joint_positions()).values[0]

        await in_time(client, client.move_to_joint_positions(joints(*LEFT)))
        set_machine(lambda: machine)
        try:
            yield arm, client, pan
        finally:
            await arm.close()


async def sent(client, q, **extra):
    """Send the arm straight towards angles; until it has arrived or rests."""
    extra = {"interpolate": False, **extra}
    await in_time(client, client.move_through_joint_positions([joints(*q)], extra=extra))


async def test_targets_without_a_plan_stop_short_of_a_component_until_it_is_gone(machine):
    async with on_the_left(machine) as (_, client, pan):
        with pytest.raises(GRPCError, match="close to 'crate'"):
            await sent(client, RIGHT)
        assert await pan() > 5.0
        machine.configs.remove(CRATE)

        async def passes():
            try:
                await sent(client, RIGHT)
            except GRPCError as refused:
                if "'crate'" not in refused.message:
                    raise
                return False
            return True

        await until(passes)
        assert await pan() == pytest.approx(-60.0, abs=0.1)


async def test_an_ignored_component_and_no_guard_are_no_obstacle(machine):
    for attributes in ({"ignore_components": ["crate"]}, {"collision_guard": False}):
        async with on_the_left(machine, **attributes) as (_, client, pan):
            await sent(client, RIGHT)
            assert await pan() == pytest.approx(-60.0, abs=0.1)


async def test_a_machine_that_cannot_be_read_is_an_error_as_for_plans(machine):
    async with on_the_left(machine) as (_, client, pan):
        machine.configs.append(hanging("shed"))
        for extra in ({"waitAtEnd": False}, {}):
            await refused(
                sent(client, RIGHT, **extra),
                Status.UNAVAILABLE,
                '"shed" has a frame but does not run',
                '"ignore_components": ["shed"]',
            )
        with pytest.raises(GRPCError, match='"shed" has a frame but does not run'):
            await streamed(client, LEFT, RIGHT)
        assert await pan() == pytest.approx(60.0, abs=0.1)


@asynccontextmanager
async def teleoperated(machine, *also, **attributes):
    """A teleoperation of an arm beside a crate that stands where its leader is going to be."""
    arms = [new_arm(name=name, **QUICK) for name in ("arm", "leader")]
    machine.configs = [
        hanging("arm", joints=5),
        hanging("leader", x=2000.0, joints=5),
        AT_THE_SIDE,
        *also,
    ]
    set_machine(lambda: machine)
    named = {"leader_arm": "leader", "follower_arm": "arm", "manage_leader_torque": False}
    config = config_of("rdk:service:generic", "devrel:so101:teleop", named | attributes, "teleop")
    teleop = So101Teleop.new(config, {})
    async with client_of(teleop) as client, client_of(arms[0]) as follower:
        try:
            yield client, arms[1].rig.arm, follower
        finally:
            await teleop.close()
            for arm in arms:
                await arm.close()


async def goes_to(leader, pan):
    """Let the leader turn its pan."""
    slowly = leader.limits.lowered_to(to_rad(20.0), to_rad(100.0))
    goal = JointGoal(q=np.radians([pan, 0.0, 0.0, 0.0, 0.0]))
    await asyncio.wrap_future(leader.move(goal, limits=slowly, wait=False).future)


async def test_a_follower_keeps_off_a_component_until_it_is_gone(machine):
    async with teleoperated(machine) as (client, leader, follower):

        async def pan():
            return (await follower.get_joint_positions()).values[0]

        async def status():
            return await client.do_command({"command": "status"})

        async def is_held():
            return any("'crate'" in each for each in (await status())["held_by"])

        async def has_passed():
            return abs(await pan() + 90.0) < 2.0

        async def is_mirroring():
            return (await status())["state"] == "mirroring"

        await client.do_command({"command": "start"})
        await until(is_mirroring)
        await goes_to(leader, -90.0)
        await until(is_held)
        assert await pan() > -45.0
        machine.configs.remove(AT_THE_SIDE)
        await until(has_passed)


async def test_a_teleoperation_is_refused_beside_what_cannot_be_read(machine):
    async with teleoperated(machine, hanging("shed")) as (client, *_):
        with pytest.raises(GRPCError, match='"shed" has a frame but does not run'):
            await client.do_command({"command": "start"})
        assert not (await client.do_command({"command": "status"}))["running"]


WAITS = "teleoperation waits for the machine"


async def test_one_that_starts_by_itself_waits_for_the_machine(machine, caplog):
    async with teleoperated(machine, hanging("shed"), auto_start=True) as (client, *_):
        await until(lambda: WAITS in caplog.text)
        machine.things["shed"] = Thing("shed")

        async def is_running():
            return (await client.do_command({"command": "status"}))["running"]

        await until(is_running)
        assert caplog.text.count(WAITS) == 1


async def test_a_stop_ends_one_that_waits_to_start_by_itself(machine, caplog):
    async with teleoperated(machine, hanging("shed"), auto_start=True) as (client, *_):
        await until(lambda: WAITS in caplog.text)
        assert await client.do_command({"command": "stop"}) == {"running": False}
        machine.things["shed"] = Thing("shed")
        await asyncio.sleep(0.1)
        assert not (await client.do_command({"command": "status"}))["running"]


async def streamed(client, begin, end):
    """Send a smooth swing as time-stamped points, half a second in each batch."""
    points = [
        Arm.TrajectoryPoint(time=timedelta(seconds=each.t), positions=np.degrees(each.q).tolist())
        for each in swing(np.radians(begin), np.radians(end), seconds=4.0)
    ]

    async def batches():
        for k in range(0, len(points), 25):
            yield points[k : k + 25]

    async def play():
        async for _ in client.move_through_joint_positions_streamed(batches()):
            pass

    await in_time(client, play())


async def test_a_stream_stops_before_a_component_until_it_is_gone(machine):
    async with on_the_left(machine) as (arm, client, pan):
        await refused(
            streamed(client, LEFT, RIGHT),
            Status.ABORTED,
            "into contact with 'crate'; move that away",
        )
        assert await pan() > 5.0
        await in_time(client, client.move_to_joint_positions(joints(*LEFT)))
        machine.configs.remove(CRATE)
        await arm.guarded_scene.read()
        await streamed(client, LEFT, RIGHT)
        assert await pan() == pytest.approx(-60.0, abs=0.1)


async def test_an_arm_that_a_hand_leads_into_a_component_says_what_it_touches(machine, caplog):
    async with on_the_left(machine) as (arm, client, _pan):

        def push(q):
            return asyncio.wrap_future(arm.rig.executor.call(lambda driver: driver.push(q)))

        async def touching():
            return (await client.get_status())["touching"]

        await client.set_manual_mode(True)
        assert await touching() == ""
        inside = np.radians([5.0, *LEFT[1:]])
        await push(inside)

        async def says(wanted):
            await advance(client, 0.1)
            return wanted in await touching() if wanted else not await touching()

        with caplog.at_level(logging.WARNING):
            await until(lambda: says("close to 'crate'"))
        assert "that a hand guides has the" in caplog.text
        await push(np.radians(LEFT))
        await until(lambda: says(""))
        await push(inside)
        await until(lambda: says("close to 'crate'"))
        await client.set_manual_mode(False)
        assert await touching() == ""
