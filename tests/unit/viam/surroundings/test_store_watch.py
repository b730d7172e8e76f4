import logging
from contextlib import asynccontextmanager

import numpy as np
import pytest
from grpclib import GRPCError, Status
from harness.fake_machine import FakeMachine, FakeStore, StandingArm, Thing, hanging, seen_thing
from harness.fake_parent import until
from harness.in_process_module import client_of
from viam.proto.common import Transform

from so101_motion.common.errors import SurroundingsUnknown
from so101_motion.planning.collision.scene import Scene
from so101_motion.viam.conversion.frames import set_machine
from so101_motion.viam.conversion.geometries import shown_id
from so101_motion.viam.surroundings import store_watch
from so101_motion.viam.surroundings.machine_bodies import MachineBodies
from so101_motion.viam.surroundings.machine_cell import MachineCell
from so101_motion.viam.surroundings.store_watch import StoreWatch

LOGGER = logging.getLogger("test")


@asynccontextmanager
async def watched(store):
    """What a plan would be made in, by name, when it is asked for.

    As a plan of the module does, it first asks the machine something over the store's connection.
    So what the store has sent before that was heard.
    """
    machine = FakeMachine(
        hanging("arm", x=100.0, joints=5), hanging("camera"), things=[Thing("camera")]
    )
    set_machine(lambda: machine)
    reader = MachineBodies("arm", (), {"arm": StandingArm()}, (), MachineCell({}))
    async with client_of(store) as client:
        watch = StoreWatch("seen", client, LOGGER)

        async def scene():
            await client.do_command({})
            return await watch.added_to(Scene(), await reader.read())

        try:
            yield scene
        finally:
            await watch.close()
            for queue in store.streams:
                queue.put_nowait(None)
            set_machine(lambda: None)


def places(scene):
    return {each.name: round(float(each.T_base_obstacle.p[0]), 6) for each in scene.obstacles}


async def test_what_comes_moves_and_goes_is_in_the_next_scene(monkeypatch):
    """The list is not compared, so a change comes through the stream or not at all."""
    monkeypatch.setattr(store_watch, "_COMPARED", 3600.0)
    store = FakeStore(seen_thing("crate"))
    async with watched(store) as scene:
        assert places(await scene()) == {"crate": 0.2}
        await until(lambda: store.streams)
        store.has(seen_thing("crate", x=310.0))  # the message that viam-server drops
        assert places(await scene()) == {"crate": 0.21}
        asked = store.asked
        store.has(seen_thing("mug", x=500.0))
        assert places(await scene()) == {"crate": 0.21, "mug": 0.4}
        store.has(seen_thing("mug", x=550.0))
        assert places(await scene()) == {"crate": 0.21, "mug": 0.45}
        store.forget("crate")
        assert places(await scene()) == {"mug": 0.45}
    assert store.asked == asked


async def has(scene, wanted):
    return places(await scene()) == wanted


async def test_a_change_that_does_not_say_all_is_asked_for():
    store = FakeStore(seen_thing("crate"))
    async with watched(store) as scene:
        await scene()
        store.has(seen_thing("mug"))
        await until(lambda: has(scene, {"crate": 0.2, "mug": 0.2}))
        store.things[b"crate"] = seen_thing("crate", x=700.0)
        store.say("updated", Transform(uuid=b"crate"))
        await until(lambda: has(scene, {"crate": 0.6, "mug": 0.2}))


async def test_what_moved_while_the_stream_was_down_is_where_it_is_now():
    store = FakeStore(seen_thing("crate"))
    async with watched(store) as scene:
        assert places(await scene()) == {"crate": 0.2}
        store.things[b"crate"] = seen_thing("crate", x=550.0)
        for queue in store.streams:
            queue.put_nowait(None)
        await until(lambda: has(scene, {"crate": 0.45}))


async def test_what_the_stream_never_tells_is_found_also_while_other_things_change(monkeypatch):
    """As with a store that divides its changes among its readers."""
    monkeypatch.setattr(store_watch, "_COMPARED", 0.05)
    store = FakeStore(seen_thing("crate"), seen_thing("mug"), seen_thing("ball"))

    async def found_beside_the_moving_ball(wanted):
        store.has(seen_thing("ball", x=500.0))
        return await has(scene, wanted | {"ball": 0.4})

    async with watched(store) as scene:
        assert len(places(await scene())) == 3
        store.say("added", Transform())  # the message that viam-server drops
        await scene()
        store.things[b"crate"] = seen_thing("crate", x=550.0)
        del store.things[b"mug"]
        await until(lambda: found_beside_the_moving_ball({"crate": 0.45}))


async def test_many_changes_that_do_not_say_all_are_read_once_a_thing():
    store = FakeStore(*(seen_thing(f"cup {i}") for i in range(5)))
    async with watched(store) as scene:
        await scene()
        store.say("added", Transform())  # the message that viam-server drops
        await scene()
        asked = store.asked
        for _ in range(100):
            for uuid in store.things:
                store.say("updated", Transform(uuid=uuid))
        await scene()
    assert store.asked - asked < 100


async def test_a_thing_that_goes_while_it_is_read_is_no_trouble(caplog):
    store = FakeStore(seen_thing("crate"), seen_thing("mug"))
    async with watched(store) as scene:
        await scene()
        store.say("added", Transform())  # the message that viam-server drops
        store.say("updated", Transform(uuid=b"crate"))
        store.forget("crate")
        assert places(await scene()) == {"mug": 0.2}
    assert len(store.streams) == 1
    assert not caplog.records


async def test_what_hangs_from_the_tool_is_held():
    async with watched(FakeStore(seen_thing("screw", parent="arm"))) as scene:
        [held] = (await scene()).attached
        assert held.name == "screw"
        np.testing.assert_allclose(held.T_tool_object.p, (0.3, 0, 0), atol=1e-9)


async def test_things_of_one_name_are_told_apart_and_what_we_show_is_none():
    goal = seen_thing("arm goal")
    goal.uuid = shown_id("world", "arm goal")
    twice = (
        seen_thing("cup", uuid=b"1"),
        seen_thing("cup", x=400.0, uuid=b"2"),
        seen_thing("camera", uuid=b"3"),
    )
    async with watched(FakeStore(goal, *twice)) as scene:
        assert places(await scene()) == {"cup": 0.2, "cup 2": 0.3, "camera 2": 0.2}


async def test_an_empty_store_is_no_trouble():
    async with watched(FakeStore()) as scene:
        assert (await scene()) == Scene()


async def test_a_store_that_fails_is_not_planned_without_and_comes_back(monkeypatch):
    monkeypatch.setattr(store_watch, "LONGEST_READ", 0.15)
    store = FakeStore(seen_thing("crate"))
    store.trouble = GRPCError(Status.UNAVAILABLE, "unplugged")
    async with watched(store) as scene:
        with pytest.raises(SurroundingsUnknown, match=r'store "seen" does not answer.*unplugged'):
            await scene()
        store.trouble = None
        await until(lambda: is_known(scene))
        assert places(await scene()) == {"crate": 0.2}
        for queue in store.streams:
            queue.put_nowait(None)  # its stream ends
        await until(lambda: is_unknown(scene))


async def is_known(scene):
    try:
        await scene()
    except SurroundingsUnknown:
        return False
    return True


async def is_unknown(scene):
    return not await is_known(scene)


async def test_an_invalid_entry_is_refused_with_its_name():
    async with watched(FakeStore(seen_thing("crate", x=float("nan")))) as scene:
        with pytest.raises(
            SurroundingsUnknown, match='store "seen" has something that is not valid'
        ):
            await scene()


async def test_a_store_that_does_not_run_is_named():
    watch = StoreWatch("seen", None, LOGGER)
    with pytest.raises(SurroundingsUnknown, match='"seen" does not run'):
        await watch.added_to(Scene(), None)
    await watch.close()
