import asyncio
import math

import pytest
from grpclib import GRPCError, Status
from harness.emulated_rig import ModelBench, gripper_client

from so101_motion.viam.models.hardware_gripper import HardwareGripper


@pytest.fixture
async def bench(tmp_path, planning_process):
    bench = ModelBench(tmp_path)
    yield bench
    await bench.end()


@pytest.fixture
def gripper(bench):
    return bench.new_gripper()


@pytest.fixture
async def client(gripper, bench):
    async with gripper_client(gripper) as client:
        yield client


async def ask(client, bench, **request):
    return await bench.in_time(client.do_command(request))


async def opening(client, bench):
    return (await ask(client, bench, command="get_position"))["position_percentage"]


async def test_it_knows_what_it_holds_until_it_is_taken_away(bench, client):
    await bench.in_time(client.open())
    bench.world.put_object(0.03)
    assert await bench.in_time(client.grab()) is True
    await bench.pass_time(3.0)
    holding = await client.is_holding_something()
    assert holding.is_holding_something
    assert abs(holding.meta["load_percent"]) > 10.0
    load = await ask(client, bench, command="get_load")
    assert abs(load["load"]) > 100.0
    assert "condition" not in load
    bench.world.take_object()
    await bench.pass_time(1.0)
    assert not (await client.is_holding_something()).is_holding_something


async def test_what_the_servo_reports_of_itself_stands_beside_its_position(bench, client):
    bench.world.warm("gripper", 75.0)
    await bench.pass_time(0.5)
    for command in ("get_position", "get_load"):
        assert (await ask(client, bench, command=command))["condition"] == "overheated"


async def test_the_short_form_need_not_wait(bench, client):
    await bench.in_time(client.open())
    assert await client.do_command({"set": 20.0, "wait": False}) == {"position": 20.0}
    assert await opening(client, bench) > 60.0
    await bench.pass_time(3.0)
    assert await opening(client, bench) == pytest.approx(20.0, abs=1.5)
    assert (await client.do_command({"get": True}))["position"] == pytest.approx(20.0, abs=1.5)
    told = await ask(client, bench, command="controller_status")
    assert (told["servo_id"], told["ref_count"], told["has_controller"]) == (6, 2, True)
    with pytest.raises(GRPCError, match="true or false"):
        await client.do_command({"set": 20.0, "wait": "no"})


async def test_opening_lets_go(bench, client):
    await bench.in_time(client.open())
    bench.world.put_object(0.03)
    await bench.in_time(client.grab())
    await bench.in_time(client.open())

    assert not (await client.is_holding_something()).is_holding_something


async def test_a_silent_servo_makes_grab_an_error_and_its_position_unknown(gripper, bench, client):
    await bench.in_time(client.open())
    bench.world.disconnect("gripper")
    with pytest.raises(GRPCError) as caught:
        await bench.in_time(client.grab())

    assert caught.value.status is Status.UNAVAILABLE
    assert "gripper" in caught.value.message
    await bench.pass_time(1.0)  # until it is known to be silent, and the others are held without it
    await bench.in_time(asyncio.wrap_future(gripper.rig.executor.hold()))
    status = await client.get_status()
    assert status["state"] == "fault"
    assert "does not answer; check its cable" in status["fault"]
    told = await ask(client, bench, command="get_position")
    assert "check its cable" in told["condition"]
    assert not {"position_percentage", "position_radians", "is_holding_something"} & {
        *status,
        *told,
    }
    for call in (client.is_holding_something(), ask(client, bench, get=True)):
        with pytest.raises(GRPCError, match="check its cable"):
            await call


async def test_positions_are_set_in_ticks_and_in_percent(bench, client):
    assert await ask(client, bench, command="set_position", percentage=50.0) == {"success": True}
    position = await ask(client, bench, command="get_position")
    assert position["position_percentage"] == pytest.approx(50.0, abs=1.5)
    assert (position["open_position"], position["closed_position"]) == (95.0, 0.0)
    assert await ask(client, bench, command="set_position", servo_position=2600) == {
        "success": True
    }
    await bench.pass_time(3.0)
    assert (await ask(client, bench, command="get_position"))["servo_position"] == pytest.approx(
        2600, abs=12
    )
    await ask(client, bench, command="set_position", position_percentage=120.0)
    assert await opening(client, bench) == pytest.approx(100.0, abs=1.5)


async def test_closing_by_command_grips_what_is_there(bench, client):
    await bench.in_time(client.open())
    bench.world.put_object(0.03)
    assert await ask(client, bench, command="set_position", percentage=0.0) == {"success": True}
    assert (await ask(client, bench, command="get_position"))["is_holding_something"] is True


async def test_its_own_idea_of_open_and_closed_can_be_set(bench, client):
    answer = await ask(client, bench, command="calibrate_positions", open_position=60.0)
    assert answer == {"success": True, "open_position": 60.0, "closed_position": 0.0}
    await bench.in_time(client.open())
    assert await opening(client, bench) == pytest.approx(60.0, abs=1.5)


async def test_its_speed_can_be_set_and_counts(bench, client):
    await bench.in_time(client.grab())
    answer = await ask(client, bench, command="set_motion_params", speed=20.0)
    assert answer["success"] is True
    assert answer["speed"] == 20.0
    assert (await ask(client, bench, command="get_motion_params"))["speed"] == 20.0
    begin = bench.clock.now()
    await bench.in_time(client.open())
    assert bench.clock.now() - begin > 5.0


async def test_its_motion_params_can_be_read_and_written_back(bench, client):
    before = await ask(client, bench, command="get_motion_params")
    after = await ask(client, bench, command="set_motion_params", **before)

    assert after == {"success": True, **before}
    lower = await ask(client, bench, command="set_motion_params", acceleration=500.0)
    assert lower["acceleration"] == 500.0


@pytest.mark.parametrize(
    ("request_", "says"),
    [
        ({"command": "set_position"}, "servo_position"),
        ({"command": "set_position", "percentage": math.nan}, "finite"),
        ({"command": "set_position", "servo_position": "wide"}, "number"),
        ({"command": "calibrate_positions", "open_position": 101}, "0 to 100"),
        ({"command": "calibrate_positions", "closed_position": 99}, "below open_position"),
        ({"command": "set_motion_params", "speed": 181}, "180"),
        ({"command": "grab"}, "known"),
    ],
)
async def test_requests_that_cannot_be_done_say_why(client, request_, says):
    with pytest.raises(GRPCError) as caught:
        await client.do_command(request_)

    assert caught.value.status is Status.INVALID_ARGUMENT
    assert says in caught.value.message


async def test_it_may_name_its_arm_instead_of_a_port(bench):
    arm = bench.new_arm("left")
    gripper = bench.new(HardwareGripper, "hand", arm="left")

    assert gripper.rig.executor is arm.rig.executor
    assert bench.base.users == 3
    with pytest.raises(GRPCError) as caught:
        bench.new(HardwareGripper, "other", arm="right")
    assert "left" in caught.value.message
