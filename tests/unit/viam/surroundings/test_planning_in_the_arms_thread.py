"""A plan that begins on a motion's thread, while the event loop reads the surroundings."""

import asyncio
import logging
from concurrent.futures import Future
from types import SimpleNamespace

import pytest
from harness.fake_parent import until

from so101_motion.common.errors import Interrupted
from so101_motion.planning.collision.scene import Scene
from so101_motion.viam.surroundings.surroundings import Surroundings

OWN = Scene(floor_z=-0.01)
HIGHER, LOWER = Scene(floor_z=-0.02), Scene(floor_z=-0.03)


class Machine:
    """A machine without components."""

    is_asked, without, company = True, "", ()

    async def read(self):
        return SimpleNamespace(bodies=())


class Source:
    """Reports a scene, once it may."""

    is_steady, origin = True, ("store",)

    def __init__(self):
        self.scene = HIGHER
        self.may_answer = asyncio.Event()
        self.may_answer.set()

    async def added_to(self, scene, view):
        await self.may_answer.wait()
        return self.scene

    async def close(self):
        pass


class Planner:
    """Starts plans that end when the test says so."""

    def __init__(self):
        self.begun = []

    def plan(self, scene):
        self.begun.append((scene, Future()))
        return self.begun[-1][1]

    @property
    def scenes(self):
        return [scene for scene, _ in self.begun]


@pytest.fixture
async def bench():
    machine, source, planner = Machine(), Source(), Planner()
    surroundings = Surroundings(machine, [source], logging.getLogger("test"))
    loop = asyncio.get_running_loop()

    def start(wait_for=Future.result):
        return asyncio.create_task(
            asyncio.to_thread(surroundings.start_planning, OWN, planner.plan, wait_for, loop)
        )

    return SimpleNamespace(machine=machine, source=source, planner=planner, start=start)


async def test_the_first_plan_is_begun_when_the_surroundings_are_known(bench):
    answer = await bench.start()
    assert bench.planner.begun == [(HIGHER, answer)]


async def test_the_next_is_begun_at_once_and_is_used_if_nothing_has_changed(bench):
    await bench.start()
    bench.source.may_answer.clear()
    starting = bench.start()
    await until(lambda: len(bench.planner.begun) == 2)
    assert not starting.done()
    bench.source.may_answer.set()
    assert (HIGHER, await starting) == bench.planner.begun[1]
    assert len(bench.planner.begun) == 2


async def test_it_is_given_up_if_the_surroundings_have_changed(bench):
    await bench.start()
    bench.source.scene = LOWER
    answer = await bench.start()
    assert bench.planner.scenes == [HIGHER, HIGHER, LOWER]
    assert bench.planner.begun[1][1].cancelled()
    assert answer is bench.planner.begun[2][1]


async def test_it_is_given_up_if_another_arm_has_moved(bench):
    await bench.start()

    def moves_meanwhile(reading):
        scene = reading.result()
        bench.machine.company = ("moved",)
        return scene

    answer = await bench.start(moves_meanwhile)
    assert bench.planner.begun[1][1].cancelled()
    assert answer is bench.planner.begun[2][1]


async def test_it_is_given_up_with_its_motion(bench):
    await bench.start()

    def interrupted(reading):
        reading.cancel()
        raise Interrupted("stop")

    with pytest.raises(Interrupted):
        await bench.start(interrupted)
    assert bench.planner.begun[1][1].cancelled()
    assert len(bench.planner.begun) == 2


async def test_nothing_is_begun_early_beside_a_source_that_always_changes(bench):
    await bench.start()
    bench.source.is_steady = False
    await bench.start()
    assert bench.planner.scenes == [HIGHER, HIGHER]
    assert not bench.planner.begun[1][1].cancelled()
