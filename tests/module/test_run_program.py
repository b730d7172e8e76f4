"""Programs through the request of an arm component, on the simulated arm."""

import asyncio

import numpy as np
import pytest
from grpclib import Status
from harness.in_process_module import advance, in_time, refused

A, B = [10, -10, 10, 0, 0], [-10, -10, 10, 0, 0]


def request(*places, **entries):
    waypoints = [{"name": f"{k}", "q_deg": q} for k, q in enumerate(places, 1)]
    return {"command": "run_program", "waypoints": waypoints, **entries}


async def test_a_program_with_a_loop_is_run_to_its_end(arm, client):
    seen = []
    loops = [{"from": 1, "to": 2, "times": 3}]
    asked = request(A, B, [0.0] * 5, loops=loops, rounds=1)
    running = asyncio.ensure_future(client.do_command(asked))
    async with asyncio.timeout(60):
        while not running.done():
            seen.append(float(arm.rig.arm.state.q_ref[0]))
            await advance(client, 0.05)
    told = running.result()
    assert (told["waypoints"], told["rounds"]) == (3, 1)
    assert told["round_s"] > 1.0
    at_a = np.degrees(seen) > 9.9
    assert np.count_nonzero(~at_a[:-1] & at_a[1:]) == 3
    assert (await client.get_joint_positions()).values == pytest.approx([0.0] * 5, abs=0.1)


async def test_a_stop_ends_a_program_without_an_end(arm, client):
    running = asyncio.ensure_future(client.do_command(request(A, B, rounds="endless")))
    while not arm.rig.arm.is_moving:
        assert not running.done()
        await advance(client, 0.0)
        await asyncio.sleep(0)
    await advance(client, 0.2)
    await client.stop()
    await refused(running, Status.CANCELLED)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        (request(), "has no waypoint"),
        (request(A, B, loops=[{"from": 1, "to": 3, "times": 2}]), "within the program's 2 steps"),
        (request(A, rounds=1.5), "whole number"),
        (request(A, laps=2), "laps"),
        (request([0, 80, 20, 0, 0]), "waypoint 1 (1): "),
    ],
)
async def test_an_invalid_program_is_refused_and_nothing_moves(arm, client, asked, says):
    await refused(in_time(client, client.do_command(asked)), None, says)
    np.testing.assert_array_equal(arm.rig.arm.state.q_ref, np.zeros(5))
