"""Arms of one process that have a frame know each other's bases and held objects."""

from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
import pytest
from harness.fake_machine import FakeMachine, Thing, a_box, hanging

from so101_motion.common.clock import ManualClock
from so101_motion.rig.rig import Rig
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.viam.conversion.frames import set_machine
from so101_motion.viam.surroundings.machine_bodies import MachineBodies
from so101_motion.viam.surroundings.machine_cell import MachineCell

ARM = hanging("arm", x=100.0, joints=5)
LEFT = hanging("left", x=450.0, theta=180.0, joints=5)


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


async def test_closing_the_last_arm_empties_the_cell(bench):
    arm, left = bench.add("arm"), bench.add("left")
    await bench.read(ARM, LEFT)
    bench.close("left")
    bench.close("arm")
    assert arm.cell_member is left.cell_member is None
