"""The Move tab of several arms: simulated arms on a clock that the tests drive."""

from dataclasses import replace

import numpy as np
import pytest
from harness.fake_page import aside, pages_of, run_at_once, wait
from so101_viewer.panels.plan_panel import plan_facts
from so101_viewer.view_model import MoveModel

from so101_motion.common.units import to_rad
from so101_motion.files.cell_file import arms_in_a_circle
from so101_motion.planning.collision.apart import ROOM
from so101_motion.rig.cell_rigs import open_cell

pytestmark = pytest.mark.usefixtures("planning_process")

OVER_THE_MIDDLE = to_rad(np.array([0.0, -60.0, 60.0, 60.0, 0.0]))


class Bench:
    """Three arms and the model of their page."""

    def __init__(self, opened, clock):
        self.opened, self.clock = opened, clock
        self.arms = pages_of(opened, clock)
        self.model = MoveModel(
            opened.cell, self.arms, submit=run_at_once, now=clock.now, welcome="Welcome."
        )

    def aim(self, **targets):
        """Set a target for each arm; where none is given it stays."""
        for arm, name in zip(self.arms.values(), ("first", "second", "third"), strict=True):
            if name in targets:
                arm.set_target_joints(targets[name])
            else:
                arm.set_target_here()

    def plan(self):
        self.model.plan()
        self.model.refresh()
        return self.model

    def move(self, until):
        wait(self.model, self.clock, until)

    def says(self, words):
        return words in self.model.sentence.text


@pytest.fixture
def bench(clock):
    with open_cell(arms_in_a_circle(3), clock=clock) as opened:
        yield Bench(opened, clock)


def test_one_plan_moves_every_arm_to_its_target_and_tells_the_clearance(bench):
    bench.aim(first=aside(55.0), second=aside(50.0))
    assert bench.plan().plan_is_current
    assert bench.model.can_execute
    common = bench.model.common_plan
    assert len(common.clearances) == 3
    assert all(each.least.distance > 0.7 * ROOM for each in common.clearances)
    bench.model.preview(common.duration)
    ghosts = [each.t for each in bench.model.arms.values()]
    assert ghosts == [plan.duration for plan in common.plans.values()]
    bench.model.execute()
    bench.move(lambda: bench.says("Arrived"))
    first, second, _ = bench.opened.rigs.values()
    np.testing.assert_allclose(first.arm.state.q, aside(55.0), atol=to_rad(0.5))
    np.testing.assert_allclose(second.arm.state.q, aside(50.0), atol=to_rad(0.5))
    assert not bench.model.plan_is_current


def test_an_arm_that_waits_for_another_is_among_the_figures_of_the_plan(bench):
    bench.aim(first=aside(55.0), second=aside(50.0))
    plan = bench.plan().common_plan
    first, *others = plan.plans
    assert not {first, *others} & dict(plan_facts(plan)).keys()
    report = replace(plan.plans[first].report, waits=0.4, waits_for=(others[0],))
    waiting = {**plan.plans, first: replace(plan.plans[first], report=report)}
    facts = dict(plan_facts(replace(plan, plans=waiting)))
    assert facts[first] == f"waits 0.40 s for {others[0]}"


def test_stopping_one_arm_stops_all_and_the_page_says_so(bench):
    bench.aim(first=aside(70.0), second=aside(70.0))
    assert bench.plan().can_execute
    bench.model.execute()
    first, second, _ = (rig.arm for rig in bench.opened.rigs.values())
    bench.move(lambda: first.is_moving and second.is_moving)
    stopping = second.start_stop()
    bench.move(lambda: bench.says("Stopped. All arms hold where they are."))
    assert stopping.done()
    assert not first.is_moving


def test_a_plan_is_dropped_for_all_arms_as_soon_as_one_target_changes(bench):
    bench.aim(first=aside(60.0))
    assert bench.plan().plan_is_current
    third = list(bench.arms.values())[2]
    third.set_target_joint(0, to_rad(20.0))
    bench.model.refresh()
    assert not any(each.plan_is_current for each in bench.arms.values())
    assert not bench.model.can_execute
    assert bench.model.can_plan


def test_targets_that_arms_cannot_have_run_at_once_are_refused_with_their_names(bench):
    bench.aim(first=OVER_THE_MIDDLE, second=OVER_THE_MIDDLE, third=OVER_THE_MIDDLE)
    assert not bench.plan().plan_is_current
    assert bench.says("arm 1") or bench.says("Arm 1")


def test_a_target_out_of_reach_is_reported_with_the_name_of_the_arm(bench):
    bench.aim()
    list(bench.arms.values())[1].set_target_point(np.array([0.9, 0.0, 0.2]))
    assert bench.says("arm 2: ")
    assert not bench.model.can_plan
