"""What is around an arm, put together from its sources, and plans that begin before it is known.

A plan begins on a motion's thread, while the event loop reads the surroundings.
"""

import asyncio
import logging
from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace

import pytest
from harness.fake_parent import until

from so101_motion.common.errors import Interrupted
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Obstacle, Scene, Sphere
from so101_motion.viam.surroundings.camera_view import CameraView
from so101_motion.viam.surroundings.store_watch import StoreWatch
from so101_motion.viam.surroundings.surroundings import Surroundings

LOGGER = logging.getLogger("test")
OWN = Scene(floor_z=-0.01)


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


async def test_what_a_source_of_two_reports_is_in_a_plan_once():
    surroundings = Surroundings(Machine(), [Source("store", "seen")], LOGGER)
    same, other = Source("store", "seen"), Source("store", "more")
    assert len((await surroundings.around(Scene(), (same,))).obstacles) == 1
    assert len((await surroundings.around(Scene(), (same, other))).obstacles) == 2


def test_a_source_is_known_by_what_it_reads():
    assert StoreWatch("seen", None, LOGGER).origin == StoreWatch("seen", None, LOGGER).origin
    top = CameraView("top", None)
    assert top.origin == CameraView("top", None).origin
    assert top.origin != CameraView("top", None, "finder").origin
    assert top.origin != StoreWatch("top", None, LOGGER).origin


async def test_for_a_guard_what_a_store_has_counts_and_what_a_camera_sees_does_not():
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
async def bench():
    machine, source, planner = Machine(), Source("store"), Planner()
    surroundings = Surroundings(machine, [source], LOGGER)
    loop = asyncio.get_running_loop()

    def start(wait_for=Future.result):
        return asyncio.create_task(
            asyncio.to_thread(surroundings.start_planning, OWN, planner.plan, wait_for, loop)
        )

    return SimpleNamespace(machine=machine, source=source, begun=planner.begun, start=start)


async def test_the_first_plan_is_begun_when_the_surroundings_are_known(bench):
    answer = await bench.start()
    assert bench.begun == [(bench.source.ball(OWN), answer)]


async def test_the_next_is_begun_at_once_and_is_used_if_nothing_has_changed(bench):
    await bench.start()
    bench.source.may_answer.clear()
    starting = bench.start()
    await until(lambda: len(bench.begun) == 2)
    assert not starting.done()
    bench.source.may_answer.set()
    assert (bench.source.ball(OWN), await starting) == bench.begun[1]
    assert len(bench.begun) == 2


@pytest.mark.parametrize("change", ["the source's", "another arm's"])
async def test_it_is_given_up_if_the_surroundings_have_changed_or_another_arm_has_moved(
    bench, change
):
    await bench.start()

    def moves_meanwhile(reading):
        scene = reading.result()
        if change == "another arm's":
            bench.machine.company = ("moved",)
        return scene

    if change == "the source's":
        bench.source.radius = 0.02
    answer = await bench.start(moves_meanwhile)
    assert bench.begun[1][1].cancelled()
    assert bench.begun[2] == (bench.source.ball(OWN), answer)


async def test_it_is_given_up_with_its_motion(bench):
    await bench.start()

    def interrupted(reading):
        reading.cancel()
        raise Interrupted("stop")

    with pytest.raises(Interrupted):
        await bench.start(interrupted)
    assert bench.begun[1][1].cancelled()
    assert len(bench.begun) == 2


async def test_nothing_is_begun_early_beside_a_source_that_always_changes(bench):
    await bench.start()
    bench.source.is_steady = False
    await bench.start()
    assert len(bench.begun) == 2
    assert not bench.begun[1][1].cancelled()
