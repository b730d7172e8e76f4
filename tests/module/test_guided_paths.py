"""Guided paths and programs through the requests of an arm component, on the simulated arm."""

import asyncio
import json

import numpy as np
import pytest
from grpclib import GRPCError, Status
from harness.in_process_module import advance, do, in_time, refused
from viam.components.arm import JointPositions

from so101_motion.common.errors import ConfigError
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.guided import files

pytestmark = pytest.mark.usefixtures("data")

CORNERS = ([20, -10, 10, 0, 0], [20, -40, 40, 10, -40])


async def lead(arm, client, *way_deg):
    """A hand leads the simulated joints along corners, a second each."""
    executor = arm.rig.executor
    here = arm.rig.arm.state.q
    for corner in way_deg:
        there = np.radians(np.array(corner, dtype=float))
        for share in np.linspace(0.0, 1.0, 50)[1:]:
            executor.call(lambda driver, q=here + share * (there - here): driver.push(q))
            await advance(client, 0.02)
        here = there


async def test_a_path_is_taught_saved_listed_replayed_deleted_and_restored(arm, client, tmp_path):
    assert await do(client, "record_path", name="wave") == {"recording": "wave", "mode": "manual"}
    assert await client.get_manual_mode()
    await lead(arm, client, *CORNERS)
    assert (await do(client, "list_paths"))["recording"] == "wave"
    told = await do(client, "end_path")
    assert told["name"] == "wave"
    assert told["duration_s"] == pytest.approx(1.96, abs=0.1)
    assert told["ended_by"] == "end_path"
    assert await client.get_manual_mode(), "the hand may go on"
    content = json.loads((tmp_path / "paths" / "wave.json").read_text())
    assert content["schema"] == "so101/guided-path/1"
    assert told["file"] == str(tmp_path / "paths" / "wave.json")

    outline = await do(client, "replay_path", name="wave", tolerance_deg=1.0, outline=True)
    assert 0.2 < outline["approach_s"] < outline["replay_s"]
    assert await client.get_manual_mode(), "it was only planned"
    told = await in_time(client, do(client, "replay_path", name="wave", tolerance_deg=1.0))
    line_mm = outline.pop("tool_path_mm")
    assert told == outline
    assert not await client.get_manual_mode()
    assert (await client.get_joint_positions()).values == pytest.approx(CORNERS[-1], abs=0.1)
    assert 2 < len(line_mm) <= 400
    end = RobotModel.load().frame(np.radians(CORNERS[-1])).p
    np.testing.assert_allclose(line_mm[-1], 1000.0 * end, atol=1.0)

    listed = await do(client, "list_paths")
    assert [each["name"] for each in listed["paths"]] == ["wave"]
    assert listed["recording"] == ""
    deleted = await do(client, "delete_path", name="wave")
    assert deleted == {"deleted": "wave", "kept_as": "1 wave"}
    assert (await do(client, "list_paths"))["paths"] == []
    assert await do(client, "restore_path", kept_as="1 wave") == {"restored": "wave"}
    assert await do(client, "list_paths") == listed
    assert json.loads((tmp_path / "paths" / "wave.json").read_text()) == content


async def test_the_time_limit_of_manual_mode_ends_the_recording_and_it_is_kept(
    arm, client, tmp_path
):
    await do(client, "record_path", name="short", enabled_for=1.0)
    await lead(arm, client, [5, 0, 0, 0, 0])
    async with asyncio.timeout(30):
        while await client.get_manual_mode():
            await advance(client, 0.01)
        while not (tmp_path / "paths" / "short.json").exists():
            await advance(client, 0.01)
    told = await do(client, "end_path")
    assert told["ended_by"] == "manual mode ended"
    assert told["points"] >= 2


async def test_invalid_input_is_refused_with_a_sentence(client):
    for request_, says in [
        ({"command": "record_path"}, "letters, digits"),
        ({"command": "record_path", "name": "../x"}, "letters, digits"),
        ({"command": "record_path", "name": "a", "enabled_for": -1}, "enabled_for"),
        ({"command": "record_path", "name": "a", "seconds": 1}, "seconds"),
        ({"command": "replay_path", "name": "nobody"}, "no such path"),
        ({"command": "replay_path", "name": "a", "tolerance_deg": 90}, "tolerance_deg"),
        ({"command": "replay_path", "name": "a", "outline": "yes"}, "outline"),
        ({"command": "replay_path", "name": "a", "speed_degs_per_sec": 900}, "speed_degs_per_sec"),
        ({"command": "delete_path", "name": "nobody"}, "no such path"),
        ({"command": "restore_path"}, "is gone; only the last"),
        ({"command": "restore_path", "kept_as": "1 nobody"}, "is gone; only the last"),
        ({"command": "restore_path", "kept_as": "1 ../x"}, "letters, digits"),
        ({"command": "restore_path", "kept_as": "../1 x"}, "is gone; only the last"),
        ({"command": "play_path", "name": "a"}, "replay_path"),
    ]:
        await refused(client.do_command(request_), Status.INVALID_ARGUMENT, says)


async def test_two_recordings_at_once_and_one_that_is_there_are_refused(arm, client):
    with pytest.raises(GRPCError, match="nothing is being recorded"):
        await do(client, "end_path")
    await do(client, "record_path", name="one")
    with pytest.raises(GRPCError, match="one is being recorded already"):
        await do(client, "record_path", name="two")
    await lead(arm, client, CORNERS[0])
    await do(client, "end_path")
    with pytest.raises(GRPCError, match="is there already"):
        await do(client, "record_path", name="one")
    await do(client, "record_path", name="one", replace=True)
    await in_time(client, client.move_to_joint_positions(JointPositions(values=[0.0] * 5)))
    assert (await do(client, "end_path"))["ended_by"] == "manual mode ended"


async def test_a_path_that_could_not_be_saved_is_saved_by_the_next_request(
    arm, client, tmp_path, monkeypatch
):
    write, full = files.write, [True]

    def written(*args, **kwargs):
        if full.pop() if full else False:
            raise ConfigError("path", "wave", "cannot be written: No space left on device")
        write(*args, **kwargs)

    monkeypatch.setattr(files, "write", written)
    await do(client, "record_path", name="wave")
    await lead(arm, client, *CORNERS)
    with pytest.raises(GRPCError, match="No space left"):
        await do(client, "end_path")
    await do(client, "record_path", name="next")
    assert (tmp_path / "paths" / "wave.json").exists(), "before another one begins"
    await lead(arm, client, *CORNERS)
    assert (await do(client, "end_path"))["name"] == "next"


# Programs

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


@pytest.mark.parametrize("end", ["stop", "cancel"])
@pytest.mark.parametrize("what", ["program", "replay"])
async def test_a_stop_or_a_call_that_is_given_up_ends_it(arm, client, what, end):
    if what == "program":
        call = client.do_command(request(A, B, rounds="endless"))
    else:
        await do(client, "record_path", name="wave")
        await lead(arm, client, *CORNERS)
        await do(client, "end_path")
        call = do(client, "replay_path", name="wave")
    running = asyncio.ensure_future(call)
    while not arm.rig.arm.state.arm_moving:
        assert not running.done()
        await advance(client, 0.0)
        await asyncio.sleep(0)
    await advance(client, 0.2)
    if end == "stop":
        await client.stop()
        await refused(running, Status.CANCELLED)
    else:
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
    async with asyncio.timeout(60):
        while await client.is_moving():
            await advance(client, 0.01)


async def test_an_invalid_program_is_refused_and_nothing_moves(arm, client):
    for asked, says in [
        (request(), "has no waypoint"),
        (request(A, B, loops=[{"from": 1, "to": 3, "times": 2}]), "within the program's 2 steps"),
        (request(A, rounds=1.5), "whole number"),
        (request(A, laps=2), "laps"),
        (request([0, 80, 20, 0, 0]), "waypoint 1 (1): "),
    ]:
        await refused(in_time(client, client.do_command(asked)), None, says)
        np.testing.assert_array_equal(arm.rig.arm.state.q_ref, np.zeros(5))
