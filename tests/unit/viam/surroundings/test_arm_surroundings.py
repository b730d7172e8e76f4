"""What is around an arm, put together from its sources, and plans that begin before it is known.

Also when a guard learns of it. A plan begins on a motion's thread, while the event loop reads the
surroundings.
"""

import asyncio
import logging
from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace

import pytest
from harness.fake_parent import until

from so101_motion.common.errors import Interrupted, SurroundingsUnknown
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Obstacle, Scene, Sphere
from so101_motion.viam.surroundings import guarded_scene
from so101_motion.viam.surroundings.guarded_scene import KNOWN_FOR, RENEWED, GuardedScene
from so101_motion.viam.surroundings.surroundings import Surroundings

LOGGER = logging.getLogger("test")
OWN, OTHER = Scene(floor_z=-0.01), Scene(floor_z=-0.02)
FULL, EMPTIER = Scene(floor_z=-0.03), Scene(floor_z=-0.04)


class Machine:
    """A machine without components."""

    is_asked, without, company = True, "", ()

    async def read(self):
        return SimpleNamespace(bodies=())


class Source:
    """A store, or with ``is_steady`` false a camera, that reports balls once it may."""

    def __init__(self, *origin, is_steady=True):
        self.origin, self.is_steady, self.radius = origin, is_steady, 0.01
        self.may_answer = asyncio.Event()
        self.may_answer.set()

    def ball(self, scene):
        name = f"ball {len(scene.obstacles)}"
        shape = Sphere(radius=self.radius)
        ball = Obstacle(name=name, shape=shape, T_base_obstacle=SE3.identity())
        return replace(scene, obstacles=(*scene.obstacles, ball))

    async def added_to(self, scene, view):
        await self.may_answer.wait()
        return self.ball(scene)


async def test_a_source_named_twice_counts_once_and_for_a_guard_stores_count_and_cameras_do_not():
    surroundings = Surroundings(Machine(), [Source("store", "seen")], LOGGER)
    same, other = Source("store", "seen"), Source("store", "more")
    assert len((await surroundings.around(Scene(), (same,))).obstacles) == 1
    assert len((await surroundings.around(Scene(), (same, other))).obstacles) == 2
    sources = [Source("store"), Source("camera", is_steady=False)]
    surroundings = Surroundings(Machine(), sources, LOGGER)
    assert len((await surroundings.standing(OWN)).obstacles) == 1
    assert len((await surroundings.around(OWN)).obstacles) == 2


class Planner:
    """Starts plans that end when the test says so."""

    def __init__(self):
        self.begun = []

    def plan(self, scene):
        self.begun.append((scene, Future()))
        return self.begun[-1][1]


@pytest.fixture
async def planning():
    machine, source, planner = Machine(), Source("store"), Planner()
    surroundings = Surroundings(machine, [source], LOGGER)
    loop = asyncio.get_running_loop()

    def start(wait_for=Future.result):
        return asyncio.create_task(
            asyncio.to_thread(surroundings.start_planning, OWN, planner.plan, wait_for, loop)
        )

    return SimpleNamespace(machine=machine, source=source, begun=planner.begun, start=start)


async def test_the_next_is_begun_at_once_and_is_used_if_nothing_has_changed(planning):
    await planning.start()
    planning.source.may_answer.clear()
    starting = planning.start()
    await until(lambda: len(planning.begun) == 2)
    assert not starting.done()
    planning.source.may_answer.set()
    assert (planning.source.ball(OWN), await starting) == planning.begun[1]
    assert len(planning.begun) == 2


@pytest.mark.parametrize("change", ["the source's", "another arm's"])
async def test_it_is_given_up_if_the_surroundings_have_changed_or_another_arm_has_moved(
    planning, change
):
    await planning.start()

    def moves_meanwhile(reading):
        scene = reading.result()
        if change == "another arm's":
            planning.machine.company = ("moved",)
        return scene

    if change == "the source's":
        planning.source.radius = 0.02
    answer = await planning.start(moves_meanwhile)
    assert planning.begun[1][1].cancelled()
    assert planning.begun[2] == (planning.source.ball(OWN), answer)


async def test_it_is_given_up_with_its_motion(planning):
    await planning.start()

    def interrupted(reading):
        reading.cancel()
        raise Interrupted("stop")

    with pytest.raises(Interrupted):
        await planning.start(interrupted)
    assert planning.begun[1][1].cancelled()
    assert len(planning.begun) == 2


async def test_nothing_is_begun_early_beside_a_source_that_always_changes(planning):
    await planning.start()
    planning.source.is_steady = False
    await planning.start()
    assert len(planning.begun) == 2
    assert not planning.begun[1][1].cancelled()


class ToldArm:
    """Notes what its guard is told."""

    def __init__(self):
        self.scene, self.stops, self.told = OWN, 0, []

    def keep_off(self, own, around):
        self.told.append((own, around))


class Around:
    """Surroundings that answer once they may."""

    def __init__(self):
        self.scene, self.asked, self.may_answer = FULL, 0, asyncio.Event()
        self.may_answer.set()

    def is_asked(self):
        return self.scene is not None

    async def standing(self, scene):
        self.asked += 1
        await self.may_answer.wait()
        if isinstance(self.scene, Exception):
            raise self.scene
        return self.scene


@pytest.fixture
async def bench():
    arm, around, clock = ToldArm(), Around(), SimpleNamespace(t=100.0)
    guarded = GuardedScene(arm, around, LOGGER, now=lambda: clock.t)
    yield SimpleNamespace(arm=arm, around=around, clock=clock, guarded=guarded)
    await guarded.close()


async def test_the_first_request_waits_and_the_next_ones_do_not(bench):
    for _ in range(3):
        await bench.guarded.known()
    assert bench.arm.told == [(OWN, FULL)]
    assert bench.around.asked == 1
    for _ in range(3):
        await bench.guarded.read()
    assert (bench.around.asked, bench.arm.told) == (4, [(OWN, FULL)]), "told what changes alone"
    bench.arm.scene = OTHER
    await bench.guarded.known()
    assert bench.arm.told[-1] == (OTHER, FULL)


async def test_requests_that_keep_coming_have_it_read_again_and_do_not_wait(bench):
    await bench.guarded.known()
    bench.around.may_answer.clear()
    bench.around.scene = EMPTIER
    bench.clock.t += RENEWED + 0.1
    for _ in range(3):
        await bench.guarded.known()
    bench.around.may_answer.set()
    await until(lambda: bench.arm.told == [(OWN, FULL), (OWN, EMPTIER)])
    assert bench.around.asked == 2


@pytest.mark.parametrize("new", [True, False])
async def test_a_block_of_motion_has_it_read_again_and_again(bench, monkeypatch, new):
    for name in ("REPLANNED", "RENEWED"):
        monkeypatch.setattr(guarded_scene, name, 0.01)
    async with bench.guarded.kept_known(new=new):
        assert bench.arm.told == [(OWN, FULL)]
        bench.around.scene = EMPTIER
        await until(lambda: bench.arm.told == [(OWN, FULL), (OWN, EMPTIER)])
    asked = bench.around.asked
    await asyncio.sleep(0.05)
    assert bench.around.asked == asked


@pytest.fixture
async def waiting(bench):
    """A request that waits for the first reading."""
    bench.around.may_answer.clear()
    waiting = asyncio.ensure_future(bench.guarded.known())
    await until(lambda: bench.around.asked)
    return waiting


async def test_a_reading_for_the_scene_before_is_not_enough(bench, waiting):
    bench.arm.scene = OTHER
    bench.around.may_answer.set()
    await waiting
    assert bench.arm.told == [(OWN, FULL), (OTHER, FULL)]


async def test_what_cannot_be_read_again_is_said_once_and_refused_when_it_is_too_old(bench, caplog):
    await bench.guarded.known()
    bench.around.scene = SurroundingsUnknown("the machine is silent")
    for _ in range(2):
        bench.clock.t += RENEWED + 0.1
        asked = bench.around.asked
        await bench.guarded.known()
        await until(lambda asked=asked: bench.around.asked > asked)
    await until(lambda: "the machine is silent" in caplog.text)
    assert caplog.text.count("the machine is silent") == 1
    bench.clock.t += KNOWN_FOR
    with pytest.raises(SurroundingsUnknown, match="silent"):
        await bench.guarded.known()
    bench.around.scene = FULL
    await bench.guarded.known()
    assert bench.arm.told == [(OWN, FULL)]


async def test_a_stop_meanwhile_ends_the_request_that_waits(bench, waiting):
    bench.arm.stops += 1
    bench.around.may_answer.set()
    with pytest.raises(Interrupted, match="stop"):
        await waiting


async def test_a_cancelled_request_leaves_the_reading_to_the_others(bench, waiting):
    other = asyncio.ensure_future(bench.guarded.known())
    await asyncio.sleep(0)
    waiting.cancel()
    await asyncio.wait([waiting])
    bench.around.may_answer.set()
    await other
    assert bench.around.asked == 1


async def test_without_a_guard_only_a_teleoperation_with_one_reads_and_without_a_machine_none(
    bench,
):
    bench.around.scene = None
    await bench.guarded.known()
    assert bench.arm.told == []
    bench.around.scene = FULL
    unused = GuardedScene(bench.arm, bench.around, LOGGER, is_used=False)
    async with unused.kept_known():
        await unused.known()
        await asyncio.sleep(0)
    assert bench.around.asked == 0
    await unused.read()
    assert bench.arm.told == [(OWN, FULL)]
    await unused.close()
