"""The teleoperation service: arms of its own process directly, others through Viam."""

import asyncio
import csv
from contextlib import asynccontextmanager

import numpy as np
import pytest
from grpclib import GRPCError, Status
from grpclib.exceptions import StreamTerminatedError
from harness.fake_parent import config_of, until
from harness.in_process_module import client_of, new_arm, new_gripper, refused
from viam.components.arm import Arm, JointPositions, MoveOptions
from viam.components.gripper import Gripper

from so101_motion.common.errors import NotReady
from so101_motion.rig import simulated_rig
from so101_motion.tasks.teleop import LocalArm
from so101_motion.viam.models import teleop as teleop_module
from so101_motion.viam.models import teleop_remote
from so101_motion.viam.models.arm_resource import ArmResource
from so101_motion.viam.models.gripper_resource import GripperResource
from so101_motion.viam.models.teleop import So101Teleop

GENERIC = "rdk:service:generic"
TELEOP = "devrel:so101:teleop"


class Deaf:
    """A client that gets no answers for as long as one likes."""

    def __init__(self, client):
        self.client, self.is_deaf, self.trouble = client, False, TimeoutError("no answer")

    def __getattr__(self, name):
        return getattr(self.client, name)

    async def get_joint_positions(self, **kwargs):
        if self.is_deaf:
            raise self.trouble
        return await self.client.get_joint_positions(**kwargs)


FAST = {"speed_degs_per_sec": 90.0, "acceleration_degs_per_sec_per_sec": 400.0}
ARMS = {"leader_arm": "leader", "follower_arm": "follower"}
GRIPPERS = {"leader_gripper": "lg", "follower_gripper": "fg"}


def service(dependencies=None, **attributes):
    config = config_of(GENERIC, TELEOP, {**ARMS, **attributes}, "teleop")
    return So101Teleop.new(config, dependencies or {})


@asynccontextmanager
async def pair(here=("leader", "follower"), **attributes):
    """A leader and a follower with grippers; those not in ``here`` are reached through Viam."""
    built = {name: new_arm(name=name, **FAST) for name in ("leader", "follower")}
    grippers = {name: new_gripper(name=name) for name in ("lg", "fg")}
    dependencies = {}
    async with (
        client_of(built["leader"]) as leader,
        client_of(built["follower"]) as follower,
        client_of(grippers["lg"]) as lg,
        client_of(grippers["fg"]) as fg,
    ):
        asked = {"leader": leader, "follower": follower}
        for side, arm, jaw in (("leader", leader, lg), ("follower", follower, fg)):
            if side not in here:
                dependencies[Arm.get_resource_name(side)] = asked[side] = Deaf(arm)
                dependencies[Gripper.get_resource_name(jaw.name)] = jaw
                del ArmResource.here[side], GripperResource.here[jaw.name]
        teleop = service(dependencies, **GRIPPERS, **attributes)
        async with client_of(teleop) as client:
            try:
                yield client, *asked.values(), lg, fg
            finally:
                await teleop.close()
                for component in (*built.values(), *grippers.values()):
                    await component.close()


async def told(client):
    return await client.do_command({"command": "status"})


async def is_in(client, state):
    return (await told(client))["state"] == state


def joints(answer):
    return np.array(answer.values)


@pytest.fixture(autouse=True)
def machine_may_be_busy(monkeypatch):
    """A stall of this process is no time for the session either, and no lost answer."""
    monkeypatch.setattr(teleop_module, "MonotonicClock", simulated_rig.MonotonicClock)
    monkeypatch.setattr(teleop_remote, "PATIENCE", 30.0)


async def gently(arm, *values, speed=15.0):
    """Move an arm there, slowly."""
    goal = JointPositions(values=list(map(float, values)))
    options = MoveOptions(max_vel_degs_per_sec=speed)
    await arm.move_through_joint_positions([goal], options)


@pytest.mark.parametrize("here", [("leader", "follower"), ()])
async def test_the_follower_does_what_the_leader_does_wherever_they_are(here):
    async with pair(here, manage_leader_torque=False) as (client, leader, follower, lg, fg):
        assert await client.do_command({"command": "start"}) == {"running": True}
        await until(lambda: is_in(client, "mirroring"))
        goal = [10.0, -8.0, 6.0, 5.0, -12.0]
        await lg.do_command({"command": "set_position", "percentage": 60.0})
        await gently(leader, *goal)

        async def is_there():
            jaw = (await fg.do_command({"command": "get_position"}))["position_percentage"]
            off = joints(await follower.get_joint_positions()) - goal
            return np.abs(off).max() < 0.5 and abs(jaw - 60.0) < 2.0

        await until(is_there)
        await until(lambda: is_in(client, "mirroring"))
        status = await told(client)
        assert status["running"] is True
        assert status["streaming"] is True
        assert status["leader_limp"] is False
        assert status["cycles"] > 20
        assert status["rate_hz"] == 100.0
        assert await client.do_command({"command": "stop"}) == {"running": False}
        assert (await told(client))["state"] == "stopped"
        assert await follower.is_moving() is False


async def test_it_starts_and_stops_as_often_as_one_likes():
    async with pair() as (client, *_):
        assert await told(client) == {
            "running": False, "cycles": 0, "consecutive_errors": 0, "last_error": "",
            "rate_hz": 100.0, "state": "stopped",
        }  # fmt: skip
        for _ in range(2):
            await client.do_command({"command": "stop"})
            await client.do_command({"command": "start"})
            await client.do_command({"command": "start"})
            assert (await told(client))["leader_limp"] is True


async def test_invalid_requests_and_arms_are_refused(monkeypatch):
    async with pair() as (client, *_):
        for request, says in (
            ({"command": "begin"}, "start, stop, status"),
            ({"command": "start", "record": "../x.csv"}, "without folders"),
            ({"command": "start", "record": "x.txt"}, ".csv, .mcap"),
            ({"command": "start", "recrd": "x.csv"}, "record"),
            ({"start": True}, "start"),
        ):
            await refused(client.do_command(request), Status.INVALID_ARGUMENT, says)
        assert (await told(client))["running"] is False
        monkeypatch.setitem(ArmResource.here, "follower", ArmResource.here["leader"])
        await refused(client.do_command({"command": "start"}), None, "is on the leader")
    teleop = service()
    await refused(teleop.do_command({"command": "start"}), Status.INVALID_ARGUMENT, "leader")
    await teleop.close()


async def test_a_record_lies_in_the_modules_data_and_is_replaced_only_by_a_start_that_is_told_to(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("VIAM_MODULE_DATA", str(tmp_path))
    path = tmp_path / "recordings" / "first.csv"
    start = {"command": "start", "record": "first.csv", "fps": 50.0}
    async with pair() as (client, *_):

        async def recorded(answer):
            assert answer == {"running": True, "recording": str(path)}
            await until(lambda: is_recorded(client, 20))
            await client.do_command({"command": "stop"})
            rows = list(csv.DictReader(path.read_text().splitlines()))
            assert len(rows) >= 20
            assert "observation.state.gripper.pos" in rows[0]

        await recorded(await client.do_command(start))
        path.write_text("the earlier one")
        with pytest.raises(GRPCError, match='choose another name, or send "replace": true'):
            await client.do_command(start)
        executor = ArmResource.here["leader"].rig.executor
        executor.ask(lambda control: control.lend("calibration", lambda driver: None)).result()
        with pytest.raises(GRPCError, match="in use for calibration"):
            await client.do_command({**start, "replace": True})
        executor.ask(lambda control: control.take_back(lambda driver: True)).result()
        assert path.read_text() == "the earlier one"
        assert [each.name for each in path.parent.iterdir()] == ["first.csv"]
        await recorded(await client.do_command({**start, "replace": True}))


async def is_recorded(client, rows):
    return (await told(client)).get("recorded", 0) >= rows


async def test_the_guard_needs_an_arm_of_this_module():
    async with pair(("leader",), collision_guard=True) as (client, *_):
        with pytest.raises(GRPCError, match="collision_guard"):
            await client.do_command({"command": "start"})


@pytest.mark.parametrize("here", [("leader", "follower"), ("leader",)])
async def test_what_starts_by_itself_waits_for_servos_that_are_not_there_yet(monkeypatch, here):
    tries = []

    def look(arm):
        tries.append(arm)
        if len(tries) == 1:
            raise NotReady("no servo answers")
        own(arm)

    own = LocalArm.__post_init__
    monkeypatch.setattr(LocalArm, "__post_init__", look)
    monkeypatch.setattr(teleop_module, "_AGAIN", 0.01)
    async with pair(here, auto_start=True) as (client, *_):
        await until(lambda: is_in(client, "mirroring"))
    assert len(tries) > 1


async def test_a_jaw_elsewhere_stops_with_the_session():
    async with pair(("leader",), manage_leader_torque=False) as (client, _, _, lg, fg):
        await client.do_command({"command": "start"})
        await until(lambda: is_in(client, "mirroring"))
        own, stops = fg.stop, []

        async def stop(**kwargs):
            stops.append(kwargs)
            await own(**kwargs)

        fg.stop = stop
        await lg.open()
        await until(fg.is_moving)
        await client.do_command({"command": "stop"})
        assert stops, "once, or again where an answer came late"
        assert not await fg.is_moving()


@pytest.mark.parametrize(
    ("here", "lost", "trouble"),
    [
        ("follower", "leader", StreamTerminatedError("no answer, connection lost")),
        ("leader", "follower", TimeoutError("no answer")),
    ],
)
async def test_a_side_elsewhere_that_does_not_answer_makes_the_follower_hold(here, lost, trouble):
    async with pair((here,), manage_leader_torque=False) as (client, leader, follower, *_):
        side = {"leader": leader, "follower": follower}[lost]
        await client.do_command({"command": "start"})
        await until(lambda: is_in(client, "mirroring"))
        moving = asyncio.ensure_future(gently(leader, 40.0, 0.0, 0.0, 0.0, 0.0))
        await until(follower.is_moving)
        side.trouble, side.is_deaf = trouble, True
        await until(lambda: is_in(client, "waiting"))
        await moving
        side.is_deaf = False

        async def is_brought_back():  # once more where a busy machine loses an answer on the way
            await gently(leader, *joints(await follower.get_joint_positions()))
            return await is_in(client, "mirroring")

        await until(is_brought_back)


@pytest.mark.parametrize(
    ("here", "away", "state"),
    [(("leader", "follower"), 0.0, "mirroring"), (("leader",), 60.0, "approaching")],
)
async def test_stop_of_the_follower_ends_the_session_wherever_the_follower_is(here, away, state):
    async with pair(here, manage_leader_torque=False) as (client, leader, follower, *_):
        await leader.move_to_joint_positions(JointPositions(values=[away, 0.0, 0.0, 0.0, 0.0]))
        await client.do_command({"command": "start"})
        await until(lambda: is_in(client, state))
        await until(lambda: follower.is_moving() if away else True)
        await follower.stop()
        await ends_without_moving(client, leader, follower)


async def test_stop_counts_while_a_follower_elsewhere_waits_for_its_leader():
    async with pair(("leader",), manage_leader_torque=False) as (client, leader, follower, *_):
        await client.do_command({"command": "start"})
        await until(lambda: is_in(client, "mirroring"))
        follower.is_deaf = True
        await until(lambda: is_in(client, "waiting"))
        follower.is_deaf = False
        await follower.stop()
        await ends_without_moving(client, leader, follower)


async def ends_without_moving(client, leader, follower):
    stood = joints(await follower.get_joint_positions())
    await leader.move_to_joint_positions(JointPositions(values=[*stood[:4], stood[4] + 9.0]))
    await until(lambda: is_in(client, "stopped"))
    assert "stop" in (await told(client))["last_error"]
    assert np.abs(joints(await follower.get_joint_positions()) - stood).max() < 0.3


async def test_a_goal_that_misses_a_stop_is_refused():
    async with pair() as (_, _, follower, *_):
        known = {"interpolate": False, "stops": (await follower.get_status())["stops"]}
        goal = [JointPositions(values=[3.0, 0.0, 0.0, 0.0, 0.0])]
        await follower.move_through_joint_positions(goal, extra=known)
        await follower.stop()
        await refused(follower.move_through_joint_positions(goal, extra=known), Status.CANCELLED)
        with pytest.raises(GRPCError, match="stops"):
            await follower.move_through_joint_positions(goal, extra={"stops": "none"})
