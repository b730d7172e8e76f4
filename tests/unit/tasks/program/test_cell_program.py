"""Programs of several arms: files, what is refused, and runs on a clock the test drives."""

from contextlib import ExitStack

import numpy as np
import pytest
from harness.facing_arms import Facing, FacingArms

from so101_motion.common.errors import ConfigError, InCollision
from so101_motion.tasks.program import Program, Waypoint, Where, rehearse, start_program
from so101_motion.tasks.program.rehearsal import PASSING

pytestmark = pytest.mark.usefixtures("planning_process")

A = np.radians([50.0, -20.0, 30.0, 30.0, 0.0])
B = np.radians([60.0, -30.0, 20.0, 40.0, 20.0])


class Bench(FacingArms):
    """Two arms that run programs."""

    def start(self, program):
        return start_program(self.cell, rehearse(self.cell, program))

    def run(self, run, until=lambda: False):
        """Let time pass until the run is over; which arms moved at the same time, by the step."""
        moved, q = {}, {name: arm.state.q_ref for name, arm in self.arms.items()}

        def look():
            here = {name: arm.state.q_ref for name, arm in self.arms.items()}
            changed = {name for name in q if np.abs(here[name] - q[name]).max() > 1e-9}
            where = run.where
            moved.setdefault((where.round, *where.laps, where.index), set()).update(changed)
            q.update(here)

        self.pass_time([run.future], until, look)
        return moved


@pytest.fixture
def bench():
    with ExitStack() as stack:
        yield Bench(stack)


def at(q, name="there", **rest):
    return Waypoint(name=name, q=q, **rest)


def test_steps_move_the_arms_they_name_and_side_by_side_if_they_name_several(bench):
    steps = ({"left": at(A, pause=0.1)}, {"left": at(B, aperture=0.3), "right": at(A)})
    run = bench.start(Program(steps=steps, rounds=2))
    moved = bench.run(run)
    run.future.result()
    assert run.where == Where(round=1, index=2)
    assert moved[0, 0] == {"left"}
    assert moved[0, 1] == {"left", "right"}
    assert moved[1, 0] == {"left"}
    np.testing.assert_allclose(bench.arms["left"].state.q_ref, B, atol=1e-6)
    np.testing.assert_allclose(bench.arms["right"].state.q_ref, A, atol=1e-6)
    assert bench.cell.members["left"].gripper.aperture == pytest.approx(0.3, abs=0.02)


def test_a_step_in_which_the_arms_would_meet_is_refused_before_anything_moves(bench):
    facing = Facing(43)
    goals = facing.near(), facing.near()
    while facing.are_apart(*goals, 0.005):
        goals = facing.near(), facing.near()
    steps = ({"left": at(A)}, {"left": at(goals[0], "mug"), "right": at(goals[1])})
    with pytest.raises(InCollision, match=r"step 2 \(left to mug, right to there\): .*right's"):
        rehearse(bench.cell, Program(steps=steps))
    with pytest.raises(ConfigError, match="left, right"):
        rehearse(bench.cell, Program(steps=({"middle": at(A)},)))


def test_an_arm_that_moves_alone_passes_waypoints_while_the_others_stand_still(bench):
    by, there = at(A, passes=True), at(B)
    names = ("left", "left", "right", "left", "right")
    steps = tuple(
        {name: each} for name, each in zip(names, (by, there, by, by, there), strict=True)
    )
    program = Program(steps=steps)
    rehearsal = rehearse(bench.cell, program)
    assert [[*leg.indices] for leg in rehearsal.legs] == [[0, 1], [2], [3], [4]]
    first = rehearsal.legs[0]
    assert 0.0 < first.at[0] < first.at[1] == max(p.duration for p in first.plans.values())
    q = first.plans["left"].trajectory.q
    off = np.abs(q - A).max(axis=1)
    assert off.min() <= PASSING
    assert np.abs(first.plans["left"].trajectory.qd[off.argmin()]).max() > np.radians(5.0)
    still = first.plans["right"].trajectory.q
    assert len(still) == len(q)
    np.testing.assert_array_equal(still, np.repeat(still[:1], len(q), axis=0))
    run = start_program(bench.cell, rehearsal)
    moved = bench.run(run)
    run.future.result()
    assert {where: arms for where, arms in moved.items() if arms} == {
        (0, 0): {"left"}, (0, 1): {"left"}, (0, 2): {"right"}, (0, 3): {"left"}, (0, 4): {"right"},
    }  # fmt: skip
