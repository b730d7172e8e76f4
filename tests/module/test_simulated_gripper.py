"""The simulated gripper over gRPC, on a clock the test moves."""

import asyncio
import json
import math

import pytest
from grpclib import GRPCError, Status
from harness.in_process_module import gripper_client, new_arm, new_gripper, refused
from viam.components.arm import KinematicsFileFormat

from so101_motion.common.clock import ManualClock
from so101_motion.rig.simulated_rig import open_simulated_gripper
from so101_motion.viam.component_config import SimulatedGripperConfig
from so101_motion.viam.models.simulated_gripper import SimulatedGripper


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
async def gripper(clock):
    config = SimulatedGripperConfig.from_attributes({})
    gripper = SimulatedGripper("gripper", open_simulated_gripper(clock=clock), config)
    yield gripper
    await gripper.close()


@pytest.fixture
async def client(gripper):
    async with gripper_client(gripper) as client:
        yield client


@pytest.fixture
def in_time(clock):
    """Awaits the outcome of a call while time passes."""

    async def outcome(call):
        task = asyncio.ensure_future(call)
        while not task.done():
            await asyncio.to_thread(clock.advance, 0.01)
            await asyncio.sleep(0.001)
        return await task

    return outcome


@pytest.fixture
def until(clock):
    """Lets time pass until something is true."""

    async def come(check):
        for _ in range(500):
            if await check():
                return
            await asyncio.to_thread(clock.advance, 0.01)
        raise AssertionError("it never came true")

    return come


async def opening(client):
    return (await client.do_command({"command": "get_position"}))["position_percentage"]


async def rests(client):
    return not await client.is_moving()


async def opens(client):
    return await opening(client) > 10.0


async def test_one_by_itself_opens_and_closes_and_never_grabs_anything(client, in_time):
    await in_time(client.open())
    assert await opening(client) == pytest.approx(100.0, abs=0.1)
    assert not await client.is_moving()
    assert await in_time(client.grab()) is False
    assert await opening(client) == pytest.approx(0.0, abs=0.1)
    assert not (await client.is_holding_something()).is_holding_something
    status = await client.get_status()
    assert status["is_moving"] is False
    assert status["position_percentage"] == pytest.approx(0.0, abs=0.1)


async def test_opening_takes_as_long_as_the_published_gripper_does(client, clock, in_time, until):
    await in_time(client.grab())
    begin = clock.now()
    call = asyncio.ensure_future(client.open())
    await until(lambda: opens(client))
    await until(lambda: rests(client))
    await call

    assert 0.5 < clock.now() - begin < 1.0, "200 % a second, and a moment to start and settle"


async def test_a_position_is_set_without_waiting_for_it(client, in_time, until):
    await in_time(client.grab())
    answer = await client.do_command({"command": "set_position", "percentage": 50.0})

    assert answer == {"target_percentage": 50.0}
    assert await client.is_moving()
    await until(lambda: rests(client))
    position = await client.do_command({"command": "get_position"})
    assert position["target_percentage"] == pytest.approx(50.0)
    assert position["position_percentage"] == pytest.approx(50.0, abs=0.1)


@pytest.mark.parametrize("form", [{"set": 20.0}, {"command": "set_position", "percentage": 20.0}])
async def test_a_request_that_says_wait_is_answered_when_the_jaw_is_there(client, in_time, form):
    await in_time(client.open())
    await in_time(client.do_command({**form, "wait": True}))
    assert await opening(client) == pytest.approx(20.0, abs=0.1)


async def test_the_short_forms_work_and_are_clamped(client, until):
    assert await client.do_command({"set": 150.0}) == {"position": 100.0}
    assert await client.do_command({"set": -5.0}) == {"position": 0.0}
    await until(lambda: rests(client))
    assert (await client.do_command({"get": True}))["position"] == pytest.approx(0.0, abs=0.1)


async def test_a_request_that_is_not_understood_is_answered_with_the_known_ones(client):
    for request_, says in [
        ({"command": "set_position"}, "percentage"),
        ({"command": "set_position", "percentage": math.nan}, "finite"),
        ({"command": "set_position", "percentage": "half"}, "a number"),
        ({"command": "set_position", "percentag": 50.0}, 'did you mean "percentage"?'),
        ({"command": "set_positon"}, 'did you mean "set_position"?'),
        ({"sett": 5.0}, 'did you mean "set"?'),
        ({}, "known: "),
    ]:
        await refused(client.do_command(request_), Status.INVALID_ARGUMENT, says)


@pytest.mark.parametrize("by", ["a stop", "its client"])
async def test_a_call_that_is_ended_leaves_the_jaw_where_it_is(client, in_time, until, by):
    await in_time(client.grab())
    call = asyncio.ensure_future(client.open())
    await until(lambda: opens(client))
    if by == "a stop":
        await in_time(client.stop())
        await refused(call, Status.CANCELLED)
        assert not await client.is_moving()
    else:
        call.cancel()
        with pytest.raises(asyncio.CancelledError):
            await call
        await until(lambda: rests(client))
    position = await client.do_command({"command": "get_position"})
    assert 10.0 < position["position_percentage"] < 95.0
    if by == "a stop":
        reached = pytest.approx(position["position_percentage"], abs=0.1)
        assert position["target_percentage"] == reached


async def test_the_jaw_is_seen_to_move(client, in_time):
    await in_time(client.grab())
    closed = {g.label: g.center for g in await client.get_geometries()}
    await in_time(client.open())
    opened = {g.label: g.center for g in await client.get_geometries()}

    assert set(closed) == {"gripper_body_0", "gripper_moving"}
    assert opened["gripper_body_0"] == closed["gripper_body_0"]
    assert abs(opened["gripper_moving"].theta - closed["gripper_moving"].theta) > 30.0


async def test_its_kinematics_have_no_joints_and_so_no_inputs(client):
    kind, data, *_ = await client.get_kinematics()

    assert kind == KinematicsFileFormat.KINEMATICS_FILE_FORMAT_SVA
    assert json.loads(data)["joints"] == []
    assert await client.get_current_inputs() == []
    await client.go_to_inputs([])
    await refused(client.go_to_inputs([0.5]), Status.OUT_OF_RANGE)


async def test_a_new_configuration_leaves_the_jaw_where_it_is(client, gripper, in_time):
    await in_time(client.open())
    await gripper.close()
    anew = new_gripper(mesh_detail="high")
    try:
        async with gripper_client(anew) as client:
            assert await opening(client) == pytest.approx(100.0, abs=0.1)
    finally:
        await anew.close()


async def test_the_gripper_of_an_arm_holds_what_the_arm_has_picked_until_it_opens():
    cube = {"name": "cube", "box_mm": [30, 30, 30], "position_mm": [200, 50, 12.6], "mass_kg": 0.02}
    arm = new_arm(obstacles=[cube])
    gripper = new_gripper(arm="arm")
    async with gripper_client(gripper) as client:
        assert await client.grab() is False
        await arm.do_command({"command": "pick", "item": "cube"})
        assert (await client.is_holding_something()).is_holding_something
        (held,) = (await arm.do_command({"command": "list_items"}))["held"]
        await client.open()
        for _ in range(6000):
            await asyncio.sleep(0.01)
            if not (items := await arm.do_command({"command": "list_items"}))["held"]:
                break
        assert not (await client.is_holding_something()).is_holding_something
    (item,) = items["items"]
    assert held == item["name"] == "cube"
    assert item["position_mm"] == pytest.approx([200, 50, 12.6], abs=6.0)
    await gripper.close()
    await arm.close()
    with pytest.raises(GRPCError, match="is no simulated arm of this module"):
        new_gripper(arm="ram")
