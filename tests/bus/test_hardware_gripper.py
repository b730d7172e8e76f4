import asyncio

import pytest
from grpclib import GRPCError, Status
from harness.emulated_rig import arm_client, gripper_client
from harness.fake_parent import GRIPPER, HARDWARE_GRIPPER, config_of
from harness.in_process_module import refused

from so101_motion.viam.models.hardware_gripper import HardwareGripper


@pytest.fixture
def gripper(models):
    return models.new_gripper()


@pytest.fixture
async def client(gripper, models):
    async with gripper_client(gripper) as client:
        yield client


async def ask(client, models, **request):
    return await models.in_time(client.do_command(request))


async def opening(client, models):
    return (await ask(client, models, command="get_position"))["position_percentage"]


async def test_it_knows_what_it_holds_until_it_is_taken_away(models, client):
    await models.in_time(client.open())
    models.world.put_object(0.03)
    assert await models.in_time(client.grab()) is True
    await models.pass_time(3.0)
    holding = await client.is_holding_something()
    assert holding.is_holding_something
    assert abs(holding.meta["load_percent"]) > 10.0
    load = await ask(client, models, command="get_load")
    assert abs(load["load"]) > 100.0
    assert "condition" not in load
    models.world.take_object()
    await models.pass_time(1.0)
    assert not (await client.is_holding_something()).is_holding_something


async def test_what_the_servo_reports_of_itself_stands_beside_its_position(models, client):
    models.world.warm("gripper", 75.0)
    await models.pass_time(0.5)
    for command in ("get_position", "get_load"):
        assert (await ask(client, models, command=command))["condition"] == "overheated"


async def test_the_short_form_need_not_wait(models, client):
    await models.in_time(client.open())
    assert await client.do_command({"set": 20.0, "wait": False}) == {"position": 20.0}
    assert await opening(client, models) > 60.0
    await models.pass_time(3.0)
    assert await opening(client, models) == pytest.approx(20.0, abs=1.5)
    assert (await client.do_command({"get": True}))["position"] == pytest.approx(20.0, abs=1.5)
    told = await ask(client, models, command="controller_status")
    assert (told["servo_id"], told["ref_count"], told["has_controller"]) == (6, 2, True)


async def test_a_silent_servo_makes_grab_an_error_and_its_position_unknown(gripper, models, client):
    await models.in_time(client.open())
    models.world.disconnect("gripper")
    await refused(models.in_time(client.grab()), Status.UNAVAILABLE, "gripper")
    await models.pass_time(
        1.0
    )  # until it is known to be silent, and the others are held without it
    await models.in_time(asyncio.wrap_future(gripper.rig.executor.hold()))
    status = await client.get_status()
    assert status["state"] == "fault"
    assert "does not answer; check its cable" in status["fault"]
    told = await ask(client, models, command="get_position")
    assert "check its cable" in told["condition"]
    assert not {"position_percentage", "position_radians", "is_holding_something"} & {
        *status,
        *told,
    }
    for call in (client.is_holding_something(), ask(client, models, get=True)):
        with pytest.raises(GRPCError, match="check its cable"):
            await call


async def test_positions_are_set_in_ticks_and_in_percent(models, client):
    assert await ask(client, models, command="set_position", percentage=50.0) == {"success": True}
    position = await ask(client, models, command="get_position")
    assert position["position_percentage"] == pytest.approx(50.0, abs=1.5)
    assert (position["open_position"], position["closed_position"]) == (95.0, 0.0)
    assert await ask(client, models, command="set_position", servo_position=2600) == {
        "success": True
    }
    await models.pass_time(3.0)
    assert (await ask(client, models, command="get_position"))["servo_position"] == pytest.approx(
        2600, abs=12
    )
    await ask(client, models, command="set_position", position_percentage=120.0)
    assert await opening(client, models) == pytest.approx(100.0, abs=1.5)


async def test_its_speed_and_its_own_idea_of_open_and_closed_can_be_set(models, client):
    answer = await ask(client, models, command="calibrate_positions", open_position=60.0)
    assert answer == {"success": True, "open_position": 60.0, "closed_position": 0.0}
    answer = await ask(client, models, command="set_motion_params", speed=30.0, acceleration=500.0)
    params = await ask(client, models, command="get_motion_params")
    assert (params["speed"], params["acceleration"]) == (30.0, 500.0)
    assert answer == {"success": True, **params}
    begin = models.clock.now()
    await models.in_time(client.open())
    assert models.clock.now() - begin > 2.0
    assert await opening(client, models) == pytest.approx(60.0, abs=1.5)


async def test_it_may_name_its_arm_instead_of_a_port(models):
    arm = models.new_arm("left")
    gripper = models.new(HardwareGripper, "hand", arm="left")
    asked = config_of(GRIPPER, HARDWARE_GRIPPER, {"arm": "left"}, "hand")
    assert HardwareGripper.validate_config(asked)[0] == ["left"]

    assert gripper.rig.executor is arm.rig.executor
    assert models.base.users == 3
    with pytest.raises(GRPCError) as caught:
        models.new(HardwareGripper, "other", arm="right")
    assert "left" in caught.value.message


# Through the arm's ``servo_…`` requests, as the published module later had them


@pytest.fixture
async def arm(models):
    arm = models.new_arm()
    await models.pass_time(1.0)
    async with arm_client(arm) as client:
        yield client


async def ask_arm(arm, command, **arguments):
    return dict(await arm.do_command({"command": command, **arguments}))


async def test_the_jaw_moves_through_the_arm_and_waiting_for_it_gives_up_in_time(models, arm):
    assert await ask_arm(arm, "servo_capabilities") == {"servo_commands": True, "servo_ids": [6]}
    assert await ask_arm(arm, "servo_move", servo_id=6, percent=60) == {"percent": 60}
    await models.in_time(ask_arm(arm, "servo_wait_stop", servo_id=6))
    at = await ask_arm(arm, "servo_position", servo_id=6)
    assert at["percent"] == pytest.approx(60, abs=1.5)

    assert await ask_arm(arm, "servo_move", servo_id=6, raw=at["raw"] + 200, speed=300) == {
        "raw": at["raw"] + 200
    }
    await models.pass_time(0.3)
    assert await ask_arm(arm, "servo_moving", servo_id=6) == {"moving": True}
    on_the_way = await ask_arm(arm, "servo_position", servo_id=6)
    assert at["raw"] < on_the_way["raw"] < at["raw"] + 120, "no faster than 300 ticks a second"
    assert await models.in_time(ask_arm(arm, "servo_stop", servo_id=6)) == {}
    stopped = await ask_arm(arm, "servo_position", servo_id=6)
    await models.pass_time(0.5)
    later = await ask_arm(arm, "servo_position", servo_id=6)
    assert later["raw"] == pytest.approx(stopped["raw"], abs=4)
    assert await ask_arm(arm, "servo_moving", servo_id=6) == {"moving": False}
    await ask_arm(arm, "servo_move", servo_id=6, percent=100, speed=50)
    await models.pass_time(0.3)
    with pytest.raises(GRPCError, match="still moves"):
        await ask_arm(arm, "servo_wait_stop", servo_id=6, timeout_ms=0)
