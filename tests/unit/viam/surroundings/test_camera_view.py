"""What a camera sees and what a store of the machine lists, as a plan is given it."""

import logging
from contextlib import asynccontextmanager

import numpy as np
import pytest
from grpclib import GRPCError, Status
from grpclib.testing import ChannelFor
from harness.fake_camera import FakeCamera, FakeVision, picture
from harness.fake_machine import (
    FakeMachine,
    FakeStore,
    StandingArm,
    Thing,
    a_box,
    hanging,
    seen_thing,
)
from harness.fake_parent import until
from harness.in_process_module import client_of
from viam.components.camera import CameraClient
from viam.components.camera.service import CameraRPCService
from viam.proto.common import Transform
from viam.resource.manager import ResourceManager
from viam.services.vision import VisionClient
from viam.services.vision.service import VisionRPCService

from so101_motion.common.errors import SurroundingsUnknown
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Obstacle, PointCloud, Scene
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.frames import set_machine
from so101_motion.viam.conversion.geometries import shown_id
from so101_motion.viam.surroundings import camera_view, store_watch
from so101_motion.viam.surroundings.camera_view import CameraView
from so101_motion.viam.surroundings.machine_bodies import MachineBodies
from so101_motion.viam.surroundings.machine_cell import MachineCell
from so101_motion.viam.surroundings.store_watch import StoreWatch

MODEL = RobotModel.load()
Q = np.array((0.3, -0.6, 0.5, 0.4, 0.2))
BOX = ((0.25, -0.2, 0.1), (0.1, 0.1, 0.2))
"""Center and size [m], in the base frame, a hand's breadth from the arm."""

Q_IN_BOX = np.array((np.arctan2(0.2, 0.25), -0.6, 0.5, 0.4, 0.2))

ABOVE = dict(x=300.0, y=100.0, z=700.0, o_x=0.1, o_z=-1.0, theta=30.0)


def camera_at(**pose):
    return hanging("camera", **(ABOVE | pose))


class Bench:
    """A machine with an arm and a camera that may move."""

    def __init__(self, camera):
        self.machine = FakeMachine(hanging("arm", joints=5), camera_at())
        self.camera = camera
        self.arms = {"arm": StandingArm(Q)}

    @property
    def T_base_camera(self):
        return convert.from_pose(self.machine.configs[1].frame.pose_in_observer_frame.pose)

    def reader(self):
        set_machine(lambda: self.machine)
        return MachineBodies("arm", ["camera"], self.arms, (), MachineCell({}))

    @asynccontextmanager
    async def watching(self, finder=None):
        """What a plan would be made in, when it is asked for; over gRPC as the camera is."""
        manager = ResourceManager([self.camera] if finder is None else [self.camera, finder])
        reader = self.reader()
        services = [CameraRPCService(manager), VisionRPCService(manager)]
        async with ChannelFor(services) as channel:
            seer = None if finder is None else VisionClient(finder.name, channel)
            name = finder and finder.name
            view = CameraView("camera", CameraClient("camera", channel), name, seer)

            async def scene():
                return await view.added_to(Scene(), await reader.read())

            yield scene


def seen_by(bench, points):
    """Points of the base frame as the camera's frame has them now."""
    return bench.T_base_camera.inverse @ points


def cubes_of(scene):
    [obstacle] = scene.obstacles
    return obstacle.T_base_obstacle @ obstacle.shape.points


def off_the_box(points):
    """How far points are from the surface of ``BOX`` [m]."""
    away = np.abs(points - BOX[0]) - np.array(BOX[1]) / 2.0
    outside = np.linalg.norm(np.maximum(away, 0.0), axis=1)
    return outside + np.maximum(-away.max(axis=1), 0.0)


@pytest.fixture(autouse=True)
def a_camera_may_take_its_time_on_a_busy_machine(monkeypatch):
    monkeypatch.setattr(camera_view, "LONGEST_LOOK", 60.0)
    yield
    set_machine(lambda: None)


@pytest.fixture(scope="module")
def sight():
    return picture(MODEL.link_placements(Q, 0.0), [BOX], count=300_000)


async def test_a_camera_that_sees_the_arm_sees_what_is_around_it_alone(sight):
    bench = Bench(FakeCamera("camera", lambda: seen_by(bench, sight)))
    async with bench.watching() as scene:
        seen = await scene()
    cubes = cubes_of(seen)
    assert off_the_box(cubes).max() < 0.015 + 0.005
    assert len(cubes) > 400  # the faces of the box hold a hundred each and more
    assert CollisionModel(MODEL, seen).is_free(Q)
    assert not CollisionModel(MODEL, seen).is_free(Q_IN_BOX)

    # Were the arm not cut out, it would begin in contact with itself.
    whole = PointCloud(points=sight, resolution=0.01)
    uncut = Obstacle(name="camera", shape=whole, T_base_obstacle=SE3.identity())
    assert not CollisionModel(MODEL, Scene(obstacles=(uncut,), floor_z=None)).is_free(Q)


async def test_a_camera_that_moves_looks_again_until_it_stands(sight):
    steps = iter((40.0, 80.0))

    def look():
        """Sees from where it is, and is moved on."""
        points = seen_by(bench, sight)
        bench.machine.configs[1] = camera_at(y=next(steps, 80.0))
        return points

    bench = Bench(FakeCamera("camera", look))
    async with bench.watching() as scene:
        assert off_the_box(cubes_of(await scene())).max() < 0.02
        assert bench.camera.looks == 3
        steps = iter(np.arange(100.0, 1000.0, 50.0))
        with pytest.raises(SurroundingsUnknown, match="moved during each of 3 pictures"):
            await scene()


async def test_a_camera_that_does_not_see_is_no_reason_to_take_the_space_for_empty(sight):
    bench = Bench(FakeCamera("camera", lambda: np.full((100, 3), np.nan)))
    async with bench.watching() as scene:
        with pytest.raises(SurroundingsUnknown, match='"camera" sees no point at all'):
            await scene()
        bench.camera.look = lambda: GRPCError(Status.UNAVAILABLE, "unplugged")
        with pytest.raises(
            SurroundingsUnknown, match=r'"camera" sends no picture: unplugged; fix that'
        ):
            await scene()
    finder = FakeVision("finder", GRPCError(Status.UNKNOWN, "no header"))
    async with bench.watching(finder) as scene:
        with pytest.raises(
            SurroundingsUnknown, match='service "finder" sends no picture: no header'
        ):
            await scene()
    with pytest.raises(SurroundingsUnknown, match="does not run"):
        await CameraView("camera", None).added_to(Scene(), await bench.reader().read())


async def test_objects_of_a_vision_service_are_boxes_and_the_arm_is_none_of_them(sight):
    bench = Bench(FakeCamera("camera", lambda: sight))
    T_camera_base = bench.T_base_camera.inverse
    box = a_box(*(1000.0 * np.array(BOX[1])), "crate")
    box.center.CopyFrom(convert.to_pose(T_camera_base @ SE3.from_translation(BOX[0])))
    off = off_the_box(sight)
    arm = a_box(300, 300, 300, "mistaken")
    arm.center.CopyFrom(convert.to_pose(T_camera_base @ MODEL.frame(Q, "tool")))
    links = sight[:100_000]  # a tenth of the picture is for each two links
    objects = [(seen_by(bench, sight[off < 0.01]), [box]), (seen_by(bench, links), [arm])]
    async with bench.watching(FakeVision("finder", objects)) as scene:
        [crate] = (await scene()).obstacles
    assert crate.name == "crate"
    np.testing.assert_allclose(crate.T_base_obstacle.p, BOX[0], atol=1e-9)
    np.testing.assert_allclose(crate.shape.size, BOX[1], atol=1e-9)


async def test_a_box_without_points_is_an_object_unless_the_arm_is_there(sight):
    bench = Bench(FakeCamera("camera", lambda: sight))
    T_camera_base = bench.T_base_camera.inverse
    crate, hand = a_box(60, 60, 60, "crate"), a_box(60, 60, 60, "hand")
    crate.center.CopyFrom(convert.to_pose(T_camera_base @ SE3.from_translation(BOX[0])))
    hand.center.CopyFrom(convert.to_pose(T_camera_base @ MODEL.frame(Q, "gripper_link")))
    for cloud in (None, np.empty((0, 3))):  # none, or viam-server's file without points
        finder = FakeVision("finder", [(cloud, [crate]), (cloud, [hand])])
        async with bench.watching(finder) as scene:
            assert [each.name for each in (await scene()).obstacles] == ["crate"]


async def test_an_object_that_is_partly_the_arm_is_what_is_left_of_its_points(sight):
    bench = Bench(FakeCamera("camera", lambda: sight))
    both = a_box(600, 600, 600, "lump")
    mixed = [(seen_by(bench, sight), [both])]
    async with bench.watching(FakeVision("finder", mixed)) as scene:
        [lump] = (await scene()).obstacles
    assert isinstance(lump.shape, PointCloud)
    assert off_the_box(lump.shape.points).max() < 0.02


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


def places(scene):
    return {each.name: round(float(each.T_base_obstacle.p[0]), 6) for each in scene.obstacles}


async def test_what_comes_moves_and_goes_is_in_the_next_scene(monkeypatch):
    """All is read once only, so a change comes through the stream or not at all."""
    monkeypatch.setattr(store_watch, "_READ_AGAIN", 3600.0)
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


async def test_a_change_that_does_not_say_all_is_asked_for_and_so_is_what_moved_without_a_stream():
    store = FakeStore(seen_thing("crate"))
    async with watched(store) as scene:
        await scene()
        store.has(seen_thing("mug"))
        await until(lambda: has(scene, {"crate": 0.2, "mug": 0.2}))
        store.things[b"crate"] = seen_thing("crate", x=700.0)
        store.say("updated", Transform(uuid=b"crate"))
        await until(lambda: has(scene, {"crate": 0.6, "mug": 0.2}))
    store = FakeStore(seen_thing("crate"))
    async with watched(store) as scene:
        assert places(await scene()) == {"crate": 0.2}
        store.things[b"crate"] = seen_thing("crate", x=550.0)
        for queue in store.streams:
            queue.put_nowait(None)
        await until(lambda: has(scene, {"crate": 0.45}))


async def test_what_the_stream_never_tells_is_found_also_while_other_things_change(monkeypatch):
    """As with a store that divides its changes among its readers."""
    monkeypatch.setattr(store_watch, "_READ_AGAIN", 0.05)
    monkeypatch.setattr(store_watch, "_EACH", 0.01)
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


async def test_things_of_one_name_are_told_apart_what_we_show_is_none_and_the_tools_are_held():
    goal = seen_thing("arm goal")
    goal.uuid = shown_id("world", "arm goal")
    twice = (
        seen_thing("cup", uuid=b"1"),
        seen_thing("cup", x=400.0, uuid=b"2"),
        seen_thing("camera", uuid=b"3"),
    )
    store = FakeStore(goal, *twice, seen_thing("screw", parent="arm"))
    async with watched(store) as scene:
        seen = await scene()
    assert places(seen) == {"cup": 0.2, "cup 2": 0.3, "camera 2": 0.2}
    [held] = seen.attached  # it hangs from the tool
    assert held.name == "screw"
    np.testing.assert_allclose(held.T_tool_object.p, (0.3, 0, 0), atol=1e-9)
    async with watched(FakeStore()) as scene:
        assert (await scene()) == Scene()


async def test_an_invalid_entry_and_a_store_that_does_not_run_are_refused_by_name():
    says = 'store "seen" has something that is not valid'
    async with watched(FakeStore(seen_thing("crate", x=float("nan")))) as scene:
        with pytest.raises(SurroundingsUnknown, match=says):
            await scene()
    watch = StoreWatch("seen", None, LOGGER)
    with pytest.raises(SurroundingsUnknown, match='"seen" does not run'):
        await watch.added_to(Scene(), None)
    await watch.close()


async def test_a_store_that_fails_is_not_planned_without_and_comes_back(monkeypatch):
    monkeypatch.setattr(store_watch, "LONGEST_READ", 1.0)
    store = FakeStore(seen_thing("crate"))
    store.trouble = GRPCError(Status.UNAVAILABLE, "unplugged")
    async with watched(store) as scene:
        with pytest.raises(SurroundingsUnknown, match=r'store "seen" does not answer.*unplugged'):
            await scene()
        store.trouble = None
        await until(lambda: is_known(scene))
        assert places(await scene()) == {"crate": 0.2}
        monkeypatch.setattr(store_watch, "_AGAIN", 3600.0)  # so that it stays unknown
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
