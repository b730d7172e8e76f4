"""The jaw through the arm's ``servo_…`` requests, as the published module later had it."""

import pytest
from grpclib import GRPCError, Status
from harness.emulated_rig import ModelBench, arm_client


@pytest.fixture
async def bench(tmp_path, planning_process):
    bench = ModelBench(tmp_path)
    yield bench
    await bench.end()


@pytest.fixture
async def client(bench):
    arm = bench.new_arm()
    await bench.pass_time(1.0)
    async with arm_client(arm) as client:
        yield client


async def ask(client, command, **arguments):
    return dict(await client.do_command({"command": command, **arguments}))


async def test_the_jaw_moves_through_the_arm(bench, client):
    assert await ask(client, "servo_capabilities") == {"servo_commands": True, "servo_ids": [6]}
    assert await ask(client, "servo_move", servo_id=6, percent=60) == {"percent": 60}
    await bench.in_time(ask(client, "servo_wait_stop", servo_id=6))
    at = await ask(client, "servo_position", servo_id=6)
    assert at["percent"] == pytest.approx(60, abs=1.5)

    assert await ask(client, "servo_move", servo_id=6, raw=at["raw"] + 200, speed=300) == {
        "raw": at["raw"] + 200
    }
    await bench.pass_time(0.3)
    assert await ask(client, "servo_moving", servo_id=6) == {"moving": True}
    on_the_way = await ask(client, "servo_position", servo_id=6)
    assert at["raw"] < on_the_way["raw"] < at["raw"] + 120, "no faster than 300 ticks a second"
    assert await bench.in_time(ask(client, "servo_stop", servo_id=6)) == {}
    stopped = await ask(client, "servo_position", servo_id=6)
    await bench.pass_time(0.5)
    later = await ask(client, "servo_position", servo_id=6)
    assert later["raw"] == pytest.approx(stopped["raw"], abs=4)
    assert await ask(client, "servo_moving", servo_id=6) == {"moving": False}


async def test_waiting_for_a_jaw_that_moves_on_gives_up(bench, client):
    await ask(client, "servo_move", servo_id=6, percent=100, speed=50)
    await bench.pass_time(0.3)
    with pytest.raises(GRPCError, match="still moves"):
        await ask(client, "servo_wait_stop", servo_id=6, timeout_ms=0)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"servo_id": 3, "percent": 10}, "moves the arm, not the jaw"),
        ({"servo_id": 7, "percent": 10}, "6"),
        ({"percent": 10}, "servo_id"),
        ({"servo_id": 6}, "percent"),
        ({"servo_id": 6, "raw": 5000}, "4095"),
        ({"servo_id": 6, "percent": 10, "speed": 0}, "speed"),
    ],
)
async def test_impossible_requests_are_refused_and_nothing_moves(client, arguments, says):
    with pytest.raises(GRPCError, match=says) as caught:
        await ask(client, "servo_move", **arguments)
    assert caught.value.status is Status.INVALID_ARGUMENT
