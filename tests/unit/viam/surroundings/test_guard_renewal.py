"""When a guard learns what is around its arm, and when it is read."""

import asyncio
import logging
from types import SimpleNamespace

import pytest
from harness.fake_parent import until

from so101_motion.common.errors import Interrupted, SurroundingsUnknown
from so101_motion.planning.collision.scene import Scene
from so101_motion.viam.surroundings import guarded_scene
from so101_motion.viam.surroundings.guarded_scene import KNOWN_FOR, RENEWED, GuardedScene

OWN, OTHER = Scene(floor_z=-0.01), Scene(floor_z=-0.02)
FULL, EMPTIER = Scene(floor_z=-0.03), Scene(floor_z=-0.04)


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
    guarded = GuardedScene(arm, around, logging.getLogger("test"), now=lambda: clock.t)
    yield SimpleNamespace(arm=arm, around=around, clock=clock, guarded=guarded)
    await guarded.close()


async def test_the_first_request_waits_and_the_next_ones_do_not(bench):
    for _ in range(3):
        await bench.guarded.known()
    assert bench.arm.told == [(OWN, FULL)]
    assert bench.around.asked == 1


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


@pytest.mark.parametrize("block", ["kept_new", "kept_known"])
async def test_a_block_of_motion_has_it_read_again_and_again(bench, monkeypatch, block):
    for name in ("REPLANNED", "RENEWED"):
        monkeypatch.setattr(guarded_scene, name, 0.01)
    async with getattr(bench.guarded, block)():
        assert bench.arm.told == [(OWN, FULL)]
        bench.around.scene = EMPTIER
        await until(lambda: bench.arm.told == [(OWN, FULL), (OWN, EMPTIER)])
    asked = bench.around.asked
    await asyncio.sleep(0.05)
    assert bench.around.asked == asked


async def test_a_guard_is_told_only_what_has_changed(bench):
    for _ in range(3):
        await bench.guarded.read()
    assert (bench.around.asked, bench.arm.told) == (3, [(OWN, FULL)])


async def test_another_scene_of_the_arm_is_read_for_at_once(bench):
    await bench.guarded.known()
    bench.arm.scene = OTHER
    await bench.guarded.known()
    assert bench.arm.told[-1] == (OTHER, FULL)


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


async def test_without_a_machine_nothing_is_read(bench):
    bench.around.scene = None
    await bench.guarded.known()
    assert bench.arm.told == []


async def test_without_a_guard_only_a_teleoperation_with_one_reads(bench):
    unused = GuardedScene(bench.arm, bench.around, logging.getLogger("test"), is_used=False)
    async with unused.kept_known():
        await unused.known()
        await asyncio.sleep(0)
    assert bench.around.asked == 0
    await unused.read()
    assert bench.arm.told == [(OWN, FULL)]
    await unused.close()
