"""The Program tab of several arms: simulated arms on a clock that the tests drive."""

import numpy as np
import pytest
from harness.fake_page import aside, pages_of, run_at_once, wait
from so101_viewer.program.program_model import REST, STEP, ProgramModel

from so101_motion.common.errors import ConfigError
from so101_motion.common.units import to_rad
from so101_motion.files.cell_file import arms_in_a_circle
from so101_motion.rig.cell_rigs import open_cell
from so101_motion.tasks.program import files

pytestmark = pytest.mark.usefixtures("planning_process")

FIRST, SECOND = "arm 1", "arm 2"


class Bench:
    """Two arms and the model of their Program tab."""

    def __init__(self, opened, clock):
        self.opened, self.clock = opened, clock
        self.arms = pages_of(opened, clock)
        self.model = ProgramModel(opened.cell, self.arms, run_at_once)

    def record(self, **targets):
        """Record a step in which arms, by ``first`` and ``second``, go somewhere."""
        names = {"first": FIRST, "second": SECOND}
        for key, q in targets.items():
            self.arms[names[key]].set_target_joints(q)
        self.model.record_targets([names[key] for key in targets])

    def planned(self):
        self.model.plan()
        self.model.refresh()
        return self.model.can_run

    def move(self, until):
        wait(self.model, self.clock, until)

    def says(self, words):
        return words in self.model.sentence.text

    def q(self, name):
        return self.opened.rigs[name].arm.state.q


@pytest.fixture
def bench(clock):
    with open_cell(arms_in_a_circle(2), clock=clock) as opened:
        yield Bench(opened, clock)


def test_a_program_is_planned_and_run_side_by_side_and_one_after_the_other(bench):
    bench.record(first=aside(55.0), second=aside(50.0))
    bench.record(second=aside(60.0))
    before = bench.q(FIRST).copy()
    assert bench.planned()
    assert bench.says("Planned, no collisions.")
    np.testing.assert_array_equal(bench.q(FIRST), before)  # planning moves nothing
    bench.model.start()
    bench.move(lambda: bench.model.active == 1)
    np.testing.assert_allclose(bench.q(FIRST), aside(55.0), atol=to_rad(0.5))
    bench.move(lambda: bench.says("Done."))
    np.testing.assert_allclose(bench.q(SECOND), aside(60.0), atol=to_rad(0.5))
    assert not bench.model.can_run  # planned from elsewhere


def test_stop_ends_it_for_all_arms(bench):
    bench.record(first=aside(70.0), second=aside(70.0))
    assert bench.planned()
    bench.model.start()
    first, second = (rig.arm for rig in bench.opened.rigs.values())
    bench.move(lambda: first.is_moving and second.is_moving)
    with pytest.raises(ConfigError, match="stop the program before you change it"):
        bench.model.remove()
    second.start_stop()
    bench.move(lambda: bench.says("Stopped. All arms hold where they are; the rest was not run."))
    assert not first.is_moving
    assert not second.is_moving


def test_a_planned_program_is_played_by_ghosts_of_all_arms(bench):
    model = bench.model
    bench.record(first=aside(55.0), second=aside(50.0))
    model.edit[SECOND].set_aperture(1.0)
    model.edit[FIRST].set_pause(60.0)
    bench.record(second=aside(60.0))
    model.set_rounds(2)
    assert bench.planned()
    timeline = model.timeline
    assert [index for _, index, _, _ in timeline.pieces()] == [0, 1, 0]
    assert model.t == timeline.duration
    assert model.active is None
    _, _, began, ended = timeline.pieces()[0]
    assert began == 0.0
    assert ended < 10.0  # a pause of a minute is shown for two seconds
    model.preview(ended)
    assert model.active == 1
    for name, q in ((FIRST, 55.0), (SECOND, 50.0)):
        np.testing.assert_allclose(timeline.at(ended)[1][name].q, aside(q), atol=1e-6)
    opened = bench.opened.rigs[SECOND].gripper.angle_of(1.0)
    assert timeline.at(ended)[1][SECOND].q_jaw == pytest.approx(opened)
    model.play(2.0)
    model.refresh()
    bench.clock.advance(0.1)
    assert model.refresh()
    assert model.t == pytest.approx(ended + 0.2)
    [between] = timeline.between
    assert (between.first, between.second) == (FIRST, SECOND)
    assert 0.0 < min(timeline.nearest.values()) == between.least.distance
    np.testing.assert_array_equal(bench.q(FIRST), timeline.rehearsal.stands[FIRST].q)


def test_a_part_is_planned_and_run_from_the_chosen_step_on_or_that_step_alone(bench):
    model = bench.model
    bench.record(first=aside(55.0))
    bench.record(second=aside(55.0))
    bench.record(first=aside(65.0))
    model.set_rounds(3)
    model.choose(1)
    model.plan(REST)
    model.refresh()
    assert [index for _, index, _, _ in model.timeline.pieces()] == [0, 1]
    assert set(model.timeline.nearest) == {1, 2}
    model.preview(0.5 * model.timeline.duration)
    assert model.active in (1, 2)
    model.plan(STEP)
    model.refresh()
    assert [index for _, index, _, _ in model.timeline.pieces()] == [0]
    q_first = bench.q(FIRST)
    model.start()
    bench.move(lambda: model.active == 1)
    assert "Doing step 2 (arm 2" in model.sentence.text
    bench.move(lambda: model.run is None)
    np.testing.assert_allclose(bench.q(SECOND), aside(55.0), atol=1e-3)
    np.testing.assert_allclose(bench.q(FIRST), q_first, atol=1e-6)
    assert model.program.rounds == 3, "the program itself is as before"


def test_steps_are_edited_arm_by_arm_and_edits_are_undone(bench):
    model = bench.model
    bench.record(first=aside(55.0))
    bench.arms[SECOND].set_target_joints(aside(50.0))
    model.edit[SECOND].take_target()
    assert [*model.program.steps[0]] == [FIRST, SECOND]
    model.edit[SECOND].set_aperture(0.5)
    model.edit[SECOND].set_pause(1.5)
    model.edit[FIRST].set_speed(0.4)
    assert model.waypoint(SECOND).aperture == 0.5
    assert model.waypoint(FIRST).aperture is None
    model.edit[FIRST].leave_out()
    assert model.waypoint(FIRST) is None
    with pytest.raises(ConfigError, match="has no other arm; delete it instead"):
        model.edit[SECOND].leave_out()
    model.history.undo()
    assert model.waypoint(FIRST).speed == 0.4
    bench.record(first=aside(60.0), second=aside(60.0))
    model.move(-1)
    assert model.chosen == 0
    assert [*model.program.steps[1]] == [FIRST, SECOND]
    model.remove()
    model.remove()
    assert model.program.steps == ()
    assert not model.can_plan


def test_arms_that_are_guided_by_hand_are_recorded_where_they_stand(bench):
    model = bench.model
    arm = bench.opened.rigs[SECOND].arm
    bench.record(first=aside(55.0))
    arm.set_manual(True)
    model.refresh()
    assert bench.says("Record keeps where arm 2 stands now.")
    assert not model.can_plan
    model.record_arms([SECOND])
    model.choose(0)
    bench.arms[SECOND].set_target_joints(aside(60.0))
    model.edit[SECOND].take_place()
    for step in model.program.steps:
        np.testing.assert_allclose(step[SECOND].q, bench.q(SECOND), atol=to_rad(0.5))
    arm.set_manual(False)
    model.refresh()
    assert model.can_plan


def test_a_saved_program_is_among_those_of_several_arms(bench):
    model = bench.model
    bench.record(first=aside(55.0), second=aside(50.0))
    model.call("wave")
    model.save()
    assert files.names() == ()
    model.clear()
    model.load("wave")
    np.testing.assert_allclose(model.program.steps[0][SECOND].q, aside(50.0), atol=1e-6)
    assert bench.says("Loaded wave, 1 step.")
    model.clear()
    with pytest.raises(ConfigError, match="record a step first"):
        model.save()


def test_an_arm_that_moves_alone_passes_and_arms_that_move_together_do_not(bench):
    model = bench.model
    bench.record(first=aside(55.0))
    bench.record(first=aside(60.0))
    model.choose(0)
    model.edit[FIRST].set_passes(True)
    assert bench.planned()
    assert [leg.indices for leg in model.timeline.rehearsal.legs] == [range(2)]
    with pytest.raises(ConfigError, match="arms that move together stop at each step"):
        model.edit[SECOND].take_place()
