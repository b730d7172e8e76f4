"""The bodies that a machine puts around an arm, and arms of one process in one cell."""

import asyncio
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
import pytest
from grpclib import GRPCError, Status
from grpclib.exceptions import StreamTerminatedError
from harness.fake_machine import FakeMachine, StandingArm, Thing, a_box, hanging, status
from harness.fake_parent import until

from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import SurroundingsUnknown
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Scene
from so101_motion.rig.rig import Rig
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.viam.conversion.frames import set_machine
from so101_motion.viam.surroundings import machine_bodies, machine_view
from so101_motion.viam.surroundings.machine_bodies import ALL, MachineBodies
from so101_motion.viam.surroundings.machine_cell import MachineCell
from so101_motion.viam.surroundings.machine_view import scene_around


@pytest.fixture
def around(monkeypatch):
    """Puts a machine around an arm "arm" and reads it for that."""

    def begin(machine, ignored=(), arms=None, grippers=(), patience=2.0):
        monkeypatch.setattr(machine_bodies, "LONGEST_READ", patience)
        set_machine(lambda: machine)
        arms = arms or {"arm": StandingArm()}
        return MachineBodies("arm", ignored, arms, grippers, MachineCell({}))

    yield begin
    set_machine(lambda: None)


def by_name(bodies):
    return {body.name: body for body in bodies}


ARM = hanging("arm", x=100.0, joints=5)
LEFT = hanging("left", x=450.0, theta=180.0, joints=5)


async def test_geometries_of_the_configuration_and_of_components_are_seen_from_the_base(around):
    crate = hanging("crate", x=300.0, z=20.0, geometry=a_box(40, 60, 80, z=10.0))
    pallet = Thing("pallet", [a_box(10, 10, 10, "pallet:left", y=50.0), a_box(10, 10, 10, "foot")])
    machine = FakeMachine(ARM, crate, hanging("pallet"), things=[Thing("crate"), pallet])
    bodies = by_name((await around(machine).read()).bodies)
    assert set(bodies) == {"crate", "pallet:left", "pallet:foot"}
    assert not bodies["crate"].holder
    np.testing.assert_allclose(bodies["crate"].T.p, (0.2, 0.0, 0.03), atol=1e-9)
    np.testing.assert_allclose(bodies["crate"].shape.size, (0.04, 0.06, 0.08))
    np.testing.assert_allclose(bodies["pallet:left"].T.p, (-0.1, 0.05, 0.0), atol=1e-9)


async def test_what_hangs_from_the_tool_is_held_and_what_hangs_from_the_base_is_not(around):
    machine = FakeMachine(
        ARM,
        hanging("gripper", "arm"),
        hanging("stick", "gripper", z=100.0, geometry=a_box(10, 10, 200)),
        hanging("lamp", "arm_origin", y=200.0, geometry=a_box(10, 10, 200)),
        things=[Thing("stick"), Thing("lamp")],
    )
    bodies = by_name((await around(machine, grippers=["gripper"]).read()).bodies)
    assert bodies["stick"].holder
    np.testing.assert_allclose(bodies["stick"].T.p, (0, 0, 0.1), atol=1e-9)
    assert not bodies["lamp"].holder
    np.testing.assert_allclose(bodies["lamp"].T.p, (0, 0.2, 0), atol=1e-9)


async def test_another_arm_of_this_process_and_what_hangs_from_it_are_where_its_joints_are(around):
    left = StandingArm((0.5, -0.3, 0.2, 0.1, 0.0))
    turned = hanging("left", x=500.0, theta=180.0, joints=5)
    camera = hanging("camera", "left", geometry=a_box(20, 20, 20))
    machine = FakeMachine(ARM, turned, camera, things=[Thing("camera")])
    reader = around(machine, arms={"arm": StandingArm(), "left": left})
    bodies = by_name((await reader.read()).bodies)
    assert {"left:base", "left:upper arm", "left:jaw"} < set(bodies)
    T_base_left = SE3.from_rpy((0.0, 0.0, np.pi), (0.4, 0.0, 0.0))
    T = T_base_left @ left.T_links()["lower_arm_link"]
    np.testing.assert_allclose(bodies["left:lower arm"].T.p, T.p, atol=1e-9)
    left.q = left.q + 0.2
    moved = by_name((await reader.read()).bodies)
    assert np.linalg.norm(moved["left:jaw"].T.p - bodies["left:jaw"].T.p) > 0.01
    assert not moved["camera"].holder
    np.testing.assert_allclose(moved["camera"].T.p, (T_base_left @ left.T_end()).p, atol=1e-9)


async def test_what_hangs_from_joints_of_others_is_where_the_machine_says(around):
    machine = FakeMachine(
        ARM,
        hanging("gantry", joints=1),
        hanging("load", "gantry", geometry=a_box(20, 20, 20)),
        things=[Thing("gantry"), Thing("load")],
    )
    reader = around(machine)
    for x in (0.3, 0.5):
        machine.ends["gantry"] = SE3.from_translation((x, 0.0, 0.0))
        body = by_name((await reader.read()).bodies)["load"]
        np.testing.assert_allclose(body.T.p, (x - 0.1, 0, 0), atol=1e-9)
    del machine.ends["gantry"]
    with pytest.raises(SurroundingsUnknown, match=r'where "gantry" is.*ignore_components'):
        await reader.read()


async def test_components_are_left_out_by_name_and_one_that_says_so_has_no_geometries(around):
    machine = FakeMachine(
        ARM, *(hanging(name, geometry=a_box(10, 10, 10)) for name in "ab"), things=[Thing("b")]
    )
    assert [body.name for body in (await around(machine, ignored=["a"]).read()).bodies] == ["b"]
    assert (await around(machine, ignored=[ALL]).read()).bodies == ()
    a = Thing("a", GRPCError(Status.UNKNOWN, "rpc error: method Geometries unimplemented"))
    assert (await around(FakeMachine(ARM, hanging("a"), things=[a])).read()).bodies == ()


async def test_components_are_asked_each_time_unless_their_answer_adds_nothing(around, monkeypatch):
    board, door = Thing("board"), Thing("door", [a_box(10, 10, 10)])
    desk = Thing("desk", [a_box(20, 20, 20, "desk:body")])
    machine = FakeMachine(
        ARM,
        hanging("board"),
        hanging("door"),
        hanging("desk", y=500.0, geometry=a_box(20, 20, 20)),
        things=[board, door, desk],
    )
    reader = around(machine)
    first = (await reader.read()).bodies
    door.geometries = [a_box(10, 10, 10, y=70.0)]
    bodies = (await reader.read()).bodies
    assert [each.name for each in bodies] == [each.name for each in first]
    [body] = [each for each in bodies if each.name == "door"]
    np.testing.assert_allclose(body.T.p, (-0.1, 0.07, 0), atol=1e-9)
    assert (board.asked, door.asked, desk.asked) == (1, 2, 1)
    desk.geometries = [a_box(30, 30, 30, "desk:body")]
    monkeypatch.setattr(machine_bodies, "_ASK_AGAIN", 0.0)
    assert len((await reader.read()).bodies) == 3, "both that of the frame and what it says now"


async def test_what_is_as_it_was_makes_the_same_scene(around):
    left = StandingArm()
    machine = FakeMachine(
        ARM,
        hanging("left", x=400.0, joints=5),
        hanging("crate", geometry=a_box(10, 10, 10)),
        hanging("stick", "arm", geometry=a_box(9, 9, 99)),
        things=[Thing("crate"), Thing("stick")],
    )
    own = StandingArm()
    reader = around(machine, arms={"arm": own, "left": left})
    before = (await reader.read()).bodies
    own.q = own.q + 0.3
    assert (await reader.read()).bodies is before, "what is held is so wherever the arm is"
    first = scene_around(Scene(), before)
    left.q = left.q + 0.0015 * np.eye(5)[0]  # a tick
    assert scene_around(Scene(), (await reader.read()).bodies) == first
    left.q = left.q + 0.01
    assert scene_around(Scene(), (await reader.read()).bodies) != first


async def test_without_a_frame_system_or_a_frame_nothing_is_known(around):
    machine = FakeMachine(hanging("crate", geometry=a_box(10, 10, 10)))
    reader = around(machine)
    assert (await reader.read()).bodies == ()
    assert "no frame" in reader.without
    machine.configs = GRPCError(Status.UNIMPLEMENTED, "frame system")
    assert (await reader.read()).bodies == ()
    assert "no frame system" in reader.without


async def test_an_arm_whose_frame_is_called_otherwise_is_not_moved_through_things(around):
    """As a genuine viam-server says it of a frame with an id, today's and with typed models."""
    old, new = hanging("robot"), hanging("robot", joints=5)
    old.kinematics.update({"name": "arm", "links": [], "joints": [{"id": "1"}]})
    new.model.name = "arm"
    for own in (old, new):
        reader = around(FakeMachine(own, hanging("crate", geometry=a_box(10, 10, 10))))
        with pytest.raises(SurroundingsUnknown, match=r'is called "robot".*"id" out'):
            await reader.read()


@pytest.mark.parametrize(
    ("configs", "things", "says"),
    [
        ([hanging("a", "b"), hanging("b", "a")], [], "is attached to itself"),
        ([hanging("a", "moon")], [], '"moon", which is not a frame'),
        ([hanging("a", x=float("nan"))], [], "finite"),
        ([hanging("a", geometry=a_box(10, float("nan"), 10))], [Thing("a")], '"a" is not valid'),
        ([hanging("a", geometry=a_box(10, 10, 10, x=float("inf")))], [Thing("a")], '"a" is not'),
        ([hanging("a" * 100_000)], [], "does not run"),
        ([hanging("a")], [], '"a" has a frame but does not run'),
        ([hanging("a")], [Thing("a", GRPCError(Status.UNAVAILABLE, "unplugged"))], "unplugged"),
        ([hanging("a")], [Thing("a", [a_box(1, 1, 1)] * 1001)], "1001 geometries"),
    ],
)
async def test_invalid_and_unreadable_parts_are_refused_in_a_sentence(
    around, configs, things, says
):
    with pytest.raises(SurroundingsUnknown, match=says) as refused:
        await around(FakeMachine(ARM, *configs, things=things)).read()
    assert "ignore_components" in str(refused.value)
    assert len(str(refused.value)) < 1001


async def test_two_components_of_one_name_and_frames_without_end_are_refused_with_what_helps(
    around,
):
    """As a remote machine without a prefix brings along; none can be left out by its name."""
    with pytest.raises(SurroundingsUnknown) as refused:
        await around(FakeMachine(ARM, hanging("a"), hanging("a", x=300.0))).read()
    assert str(refused.value) == (
        'two components of the machine are called "a"; rename one, or give the remote machine'
        ' that has it a "prefix"'
    )
    names = [f"part {i}" for i in range(machine_view.MOST_PARTS + 1)]
    chain = [hanging(name, above) for name, above in zip(names[1:], names, strict=False)]
    with pytest.raises(SurroundingsUnknown, match="is attached to itself, or has more than"):
        await around(FakeMachine(ARM, hanging(names[0]), *chain[:-2])).read()
    with pytest.raises(SurroundingsUnknown, match="more than 1000 components"):
        await around(FakeMachine(ARM, *map(hanging, names))).read()


async def test_a_machine_that_does_not_answer_is_not_waited_for(around):
    machine = FakeMachine(ARM)
    machine.silent = True
    with pytest.raises(SurroundingsUnknown, match=r"within 0.01 s.*ignore_components"):
        await around(machine, patience=0.01).read()
    machine.silent, machine.configs = False, GRPCError(Status.UNKNOWN, "broken")
    with pytest.raises(SurroundingsUnknown, match="broken"):
        await around(machine).read()


async def test_a_connection_that_is_lost_is_waited_for(around):
    machine = FakeMachine(ARM, hanging("a"), things=[Thing("a", [a_box(10, 10, 10)])])
    configs, machine.configs = machine.configs, StreamTerminatedError("Connection lost")
    with pytest.raises(SurroundingsUnknown, match=r"cannot be reached: Connection lost; mend that"):
        await around(machine, patience=0.02).read()
    reading = asyncio.ensure_future(around(machine).read())
    await until(lambda: machine.asked > 1)
    machine.configs = configs
    machine.things["a"].geometries = StreamTerminatedError("Connection lost")
    await until(lambda: machine.things["a"].asked > 0)
    machine.things["a"].geometries = [a_box(10, 10, 10)]
    assert [body.name for body in (await reading).bodies] == ["a"]


async def test_an_arm_whose_joints_are_not_known_is_not_planned_around(around):
    left = StandingArm()
    left.trouble = GRPCError(Status.UNAVAILABLE, "not ready: servo 3 is silent")
    reader = around(
        FakeMachine(ARM, hanging("left", joints=5)), arms={"arm": StandingArm(), "left": left}
    )
    with pytest.raises(SurroundingsUnknown, match='"left" is unknown: not ready: servo 3'):
        await reader.read()


async def test_an_arm_that_failed_is_not_planned_through(around):
    machine = FakeMachine(ARM)
    machine.statuses = [status("arm", "arm", "READY"), status("gripper", "claw", "UNHEALTHY", "x")]
    assert (await around(machine).read()).bodies == ()
    machine.statuses.append(status("arm", "ur", "UNHEALTHY", "module exited"))
    says = r'"ur" does not run.*: module exited; .*"ignore_components": \["ur"\]'
    with pytest.raises(SurroundingsUnknown, match=says):
        await around(machine).read()
    assert (await around(machine, ignored=["ur"]).read()).bodies == ()


@pytest.mark.parametrize("late", ["arm", "left"])
async def test_an_arm_that_is_being_configured_is_waited_for(around, late):
    parts = {"arm": ARM, "left": hanging("left", y=450.0, joints=5)}
    machine = FakeMachine(*(part for name, part in parts.items() if name != late))
    machine.statuses = [status("arm", late, "CONFIGURING")]
    reader = around(machine, arms={"arm": StandingArm(), "left": StandingArm()})
    reading = asyncio.ensure_future(reader.read())
    await until(lambda: machine.asked > 0)
    machine.configs, machine.statuses = list(parts.values()), []
    assert "left:jaw" in by_name((await reading).bodies)


async def test_what_hangs_from_nothing_that_is_there_can_be_left_out(around):
    crate = hanging("crate", geometry=a_box(10, 10, 10))
    lost = (hanging("claw", "ur"), hanging("tip", "claw"))
    machine = FakeMachine(ARM, crate, *lost, things=[Thing("crate")])
    with pytest.raises(SurroundingsUnknown, match=r'"ur", which is no.*: \["claw"\]'):
        await around(machine).read()
    bodies = (await around(machine, ignored=["claw", "tip"]).read()).bodies
    assert [body.name for body in bodies] == ["crate"]


async def test_what_a_remote_machine_has_hangs_from_its_world(around):
    crate = hanging("rem-crate", "rem_world", x=50.0, geometry=a_box(10, 10, 10))
    machine = FakeMachine(ARM, hanging("rem_world", x=250.0), crate, things=[Thing("rem-crate")])
    machine.statuses = [status("generic", "rem-crate", "READY")]
    reader = around(machine)
    [body] = (await reader.read()).bodies
    assert body.name == "rem-crate"
    np.testing.assert_allclose(body.T.p, (0.2, 0.0, 0.0), atol=1e-9)

    # viam-server leaves out what it has lost the connection to.
    machine.configs = [ARM]
    for _ in range(2):
        with pytest.raises(SurroundingsUnknown, match=r'has "rem-crate" is not .*\["rem_world"\]'):
            await reader.read()
    machine.statuses = []  # now the remote is no longer configured
    assert (await reader.read()).bodies == ()


async def test_a_geometry_that_viam_server_shows_as_the_frames_counts_once(around):
    """It takes the first answer for that where the configuration names none."""
    tray = a_box(10, 10, 10, "pallet:tray")
    pallet = Thing("pallet", [tray, a_box(10, 10, 10, "pallet:foot", y=50.0)])
    machine = FakeMachine(ARM, hanging("pallet", geometry=tray), things=[pallet])
    names = [body.name for body in (await around(machine).read()).bodies]
    assert names == ["pallet:tray", "pallet:foot"]


async def test_names_that_the_arm_has_itself_are_told_apart(around):
    machine = FakeMachine(
        ARM,
        hanging("gripper", "arm", geometry=a_box(10, 10, 10)),
        hanging("far", x=1e6, geometry=a_box(10, 10, 10)),
        things=[Thing("far")],
    )
    scene = scene_around(Scene(), (await around(machine, grippers=["gripper"]).read()).bodies)
    assert [held.name for held in scene.attached] == ["gripper (component)"]
    assert scene.obstacles == ()


async def test_what_was_asked_of_components_of_an_old_configuration_does_not_count(around):
    lamp, crate = Thing("lamp", [a_box(10, 10, 10)]), Thing("crate")
    machine = FakeMachine(ARM, hanging("lamp"), things=[lamp, crate])
    bodies = around(machine)
    await bodies.read()
    lamp.geometries = GRPCError(Status.INTERNAL, "broken")
    for y in (0.0, 30.0):
        machine.configs = [ARM, hanging("crate", y=y, geometry=a_box(20, 20, 20))]
        [crate] = (await bodies.read()).bodies
        assert crate.name == "crate"
        np.testing.assert_allclose(crate.T.p, (-0.1, y / 1000.0, 0), atol=1e-9)


@dataclass
class HereArm:
    """An arm of this process."""

    rig: Rig
    ignored: tuple[str, ...] = ()

    async def found(self):
        pass

    def T_end(self):
        return self.rig.arm.T_base("tool")

    def T_links(self):
        return self.rig.arm.T_base_links()


class Bench:
    """Arms of one process, and a machine that a test describes."""

    def __init__(self, stack):
        self._stack, self.arms = stack, {}
        self.cell, self.clock = MachineCell(self.arms), ManualClock()
        self.machine = FakeMachine()

    def add(self, name, clock=None, ignored=()):
        rig = self._stack.enter_context(open_simulated(clock=clock or self.clock))
        self.arms[name] = HereArm(rig, ignored)
        return rig.arm

    def close(self, name):
        here = self.arms.pop(name)
        self.cell.leave(name, here.rig)
        here.rig.close()

    async def read(self, *configs, by="arm"):
        self.machine.configs = list(configs)
        reader = MachineBodies(by, self.arms[by].ignored, self.arms, (), self.cell)
        return {body.name: body for body in (await reader.read()).bodies}


@pytest.fixture
def bench():
    with ExitStack() as stack:
        made = Bench(stack)
        set_machine(lambda: made.machine)
        yield made
        set_machine(lambda: None)


def known(arm):
    return {} if arm.cell_member is None else {each.name: each for each in arm.cell_member.others()}


async def test_arms_with_a_frame_know_each_other_and_are_no_obstacles_then(bench):
    arm, left = bench.add("arm"), bench.add("left")
    assert await bench.read(ARM, LEFT) == {}
    np.testing.assert_allclose(known(arm)["left"].T_base_other.p, (0.35, 0.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(known(left)["arm"].T_base_other.p, (0.35, 0.0, 0.0), atol=1e-9)
    moved = hanging("left", x=500.0, theta=180.0, joints=5)
    await bench.read(ARM, moved)
    np.testing.assert_allclose(known(arm)["left"].T_base_other.p, (0.4, 0.0, 0.0), atol=1e-9)
    await bench.read(ARM)
    assert known(arm) == {}
    assert left.cell_member is None


async def test_an_ignored_arm_is_not_avoided_but_avoids_others(bench):
    arm, left = bench.add("arm", ignored=("left",)), bench.add("left")
    assert await bench.read(ARM, LEFT) == {}
    assert known(arm) == {}
    assert set(known(left)) == {"arm"}


async def test_arms_whose_clocks_differ_stand_in_each_others_way(bench):
    arm = bench.add("arm")
    bench.add("left", clock=ManualClock())
    assert "left:jaw" in await bench.read(ARM, LEFT)
    assert known(arm) == {}


async def test_what_another_arm_holds_moves_with_it_and_not_as_an_obstacle(bench):
    arm, left = bench.add("arm"), bench.add("left")
    stick = hanging("stick", "left", z=100.0, geometry=a_box(10, 10, 200))
    bench.machine.things["stick"] = Thing("stick")
    assert await bench.read(ARM, LEFT, stick) == {}
    [held] = known(arm)["left"].attached
    assert held.name == "stick"
    np.testing.assert_allclose(held.T_tool_object.p, (0.0, 0.0, 0.1), atol=1e-12)
    bodies = await bench.read(ARM, LEFT, stick, by="left")
    assert bodies["stick"].holder
    assert [each.name for each in left.cell_member.attached_to(left.cell_member)] == ["stick"]


async def test_an_arm_that_is_closed_stands_in_the_way_until_the_machine_is_read_again(bench):
    """It is rebuilt with every change of its configuration, while others move on."""
    arm, closed = bench.add("arm"), bench.add("left")
    await bench.read(ARM, LEFT)
    bench.close("left")
    [stands] = known(arm)["left"].course.at(np.array([60.0]))
    np.testing.assert_allclose(stands[:5], closed.state.q, atol=1e-9)
    left = bench.add("left")
    await bench.read(ARM, LEFT)
    assert set(known(left)) == {"arm"}
    bench.close("left")
    await bench.read(ARM)
    assert known(arm) == {}
