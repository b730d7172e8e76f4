"""The Program tab's model on one and on two simulated arms, on a clock the test drives."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from harness.fake_page import CellBench, aside, run_at_once, wait
from so101_viewer.page import markup
from so101_viewer.page.guiding import GUIDED_FOR
from so101_viewer.page.screen_state import Tone
from so101_viewer.program import program_texts as words
from so101_viewer.program.program_model import REST, STEP, ProgramModel

from so101_motion.cli.view import cube_and_tray
from so101_motion.common.errors import ConfigError, MotionError
from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.files.cell_file import arms_in_a_circle
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import JointGoal
from so101_motion.rig.cell_rigs import open_cell
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.tasks.program import ARM, Loop, Program, Solo, Waypoint, files

pytestmark = pytest.mark.usefixtures("planning_process")

A = np.radians([20.0, -20.0, 20.0, 20.0, 0.0])
B = np.radians([-20.0, -20.0, 20.0, 20.0, 30.0])
INTO_THE_TABLE = np.radians([0.0, 80.0, 20.0, 0.0, 0.0])


class Tab:
    """The model with what the page gives it: a target, and a worker."""

    def __init__(self, rig, clock):
        self.rig, self._clock = rig, clock
        self.q_target = A
        self.aimed = []
        self.worker = ThreadPoolExecutor(max_workers=1)
        self.model = ProgramModel(Solo.of(rig), {ARM: self}, self.worker.submit)
        self.set = partial(self.model.set, ARM)

    @property
    def q_arm(self):
        return self.rig.arm.state.q_ref

    @property
    def target(self):
        return SimpleNamespace(q=self.q_target)

    def set_target_joints(self, q):
        self.aimed.append(q)

    def until(self, condition):
        wait(self.model, self._clock, condition)

    def record(self, *targets):
        for q in targets:
            self.q_target = q
            self.model.record_targets()

    def plan(self):
        self.model.plan()
        self.until(lambda: self.model.can_run)

    @property
    def said(self):
        return self.model.sentence.text

    @property
    def names(self):
        return "".join(each.name for each in self.model.program.waypoints)


@pytest.fixture
def tab(clock, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    with open_simulated(clock=clock, speed=to_rad(180.0), acceleration=to_rad(500.0)) as rig:
        tab = Tab(rig, clock)
        yield tab
        tab.worker.shutdown()


def test_waypoints_are_recorded_from_the_target_and_from_the_arm_and_keep_the_jaw(tab):
    tab.record(A)
    tab.model.record_arms()
    first, second = tab.model.program.waypoints
    np.testing.assert_array_equal(first.q, A)
    np.testing.assert_array_equal(second.q, np.zeros(5))
    assert first.aperture is second.aperture is None  # else a part in the jaw would be dropped
    assert tab.model.chosen == 1
    assert tab.said == "Recorded waypoint 2. Record more, or press Plan program."


def test_a_waypoint_at_which_an_item_is_picked_is_added_rehearsed_and_run(tab):
    tab.record(A)
    with pytest.raises(ConfigError, match="no item yet"):
        tab.model.pick()
    tab.rig.arm.scene = cube_and_tray()
    tab.model.pick()
    tab.set(place="tray")
    waypoint = tab.model.program.waypoints[1]
    assert (waypoint.item, waypoint.place) == ("cube", "tray")
    assert words.line(tab.model.program, 1) == "cube to tray"
    tab.plan()
    timeline = tab.model.timeline
    ((_, _, begins, ends),) = [each for each in timeline.pieces() if each[1] == 1]
    jaws = {round(timeline.at(t)[1][ARM].q_jaw, 3) for t in np.linspace(begins, ends, 50)}
    assert len(jaws) == 4  # as it was, open, closed on the cube, and open again
    tab.model.start()
    tab.until(lambda: tab.model.run is None)
    assert tab.rig.things.where("cube").p[:2] == pytest.approx([0.11, -0.2], abs=2e-3)
    tab.set(passes=True)
    assert tab.model.program.waypoints[1].item is None


def test_waypoints_keep_their_names_when_the_order_changes(tab):
    tab.record(A, B, A)
    tab.model.move(-1)
    assert tab.names == "ACB"
    assert tab.model.chosen == 1
    tab.set(name="grip")
    tab.set(pause=1.5)
    tab.set(aperture=None)
    changed = tab.model.program.waypoints[1]
    assert (changed.name, changed.pause, changed.aperture) == ("grip", 1.5, None)
    tab.model.move(1)
    tab.model.move(1)  # it is the last already
    tab.model.refresh()
    tab.model.remove()
    assert tab.model.refresh()
    assert not tab.model.refresh()
    assert tab.names == "AB"
    assert tab.model.chosen == 1
    tab.record(B)
    assert tab.names == "ABC"


def test_a_waypoint_is_passed_without_pause_and_jaw_or_it_is_stopped_at(tab):
    def first():
        waypoint = tab.model.program.waypoints[0]
        return (waypoint.passes, waypoint.pause, waypoint.aperture)

    tab.record(A, B)
    tab.model.choose(0)
    tab.set(aperture=0.0)
    tab.set(passes=True)
    assert first() == (True, 0.0, None)
    assert tab.said.endswith("Its pause and its gripper setting are removed.")
    tab.set(aperture=0.5)
    assert first() == (False, 0.0, 0.5)
    assert tab.said == "The gripper needs a stop, so this waypoint is no longer passed."
    tab.set(aperture=None)
    tab.set(passes=True)
    assert tab.said == "Passed without stopping."
    tab.set(pause=2.0)
    assert first() == (False, 2.0, None)
    assert tab.said == "A pause needs a stop, so this waypoint is no longer passed."
    tab.set(pause=0.0)
    tab.set(passes=True)
    tab.set(passes=False)
    assert first() == (False, 0.0, None)
    tab.model.choose(1)
    tab.set(passes=True)
    assert tab.said == "The arm stops at the last waypoint, until another follows it."


def test_edits_are_undone_and_redone_and_waypoints_duplicated(tab):
    tab.record(A, B)
    tab.model.choose(0)
    np.testing.assert_array_equal(tab.aimed[-1], A)  # the ghost stands there
    tab.model.choose(7)
    assert tab.model.chosen == 0
    tab.model.duplicate()
    assert (tab.names, tab.model.chosen) == ("ACB", 1)
    tab.model.take_place(ARM)
    np.testing.assert_array_equal(tab.model.program.waypoints[1].q, np.zeros(5))
    tab.model.history.undo()
    np.testing.assert_array_equal(tab.model.program.waypoints[1].q, A)
    tab.model.history.undo()
    assert tab.names == "AB"
    tab.model.history.redo()
    assert tab.names == "ACB"
    for _ in range(9):
        tab.model.history.undo()
    assert (tab.names, tab.model.chosen, tab.model.history.can_undo) == ("", None, False)


def test_a_wait_stays_where_the_step_before_it_stands_and_a_saved_program_is_inserted(tab):
    tab.record(A, B)
    tab.model.name = "pick"
    tab.model.save()
    tab.model.choose(0)
    tab.model.wait()
    wait = tab.model.program.waypoints[1]
    assert (wait.name, wait.pause, tab.model.chosen) == ("wait", 1.0, 1)
    np.testing.assert_array_equal(wait.q, A)
    tab.model.insert("pick")
    assert (tab.names, tab.model.chosen) == ("AwaitABB", 3)
    tab.model.delete("pick")
    numbers = tab.model.history.undoes, tab.model.saved_files.undoes
    assert 0 < numbers[0] < numbers[1]  # the newest is undone first: the file
    tab.model.set_run_speed(0.5)
    tab.plan()
    tab.model.start()
    assert tab.model.run.speed == 0.5
    tab.model.run.stop()
    tab.until(lambda: tab.model.run is None)


def test_a_step_of_many_arms_that_all_do_the_same_is_said_once():
    slow = Program.of_waypoints([Waypoint(name="up", q=np.zeros(5), speed=0.5)])
    for arms, title in (("ab", "a, b"), ("abcdefghij", "10 arms")):
        program = slow.for_all(arms)
        assert (words.title(program, 0), words.line(program, 0)) == (title, "50 % speed")
    assert program.called(0) == "step 1 (10 arms)"


def test_a_loop_is_shown_twice_on_the_line_of_time_and_told_while_it_runs(tab):
    tab.record(A, B, A)
    tab.model.set_loop(0, 1, 3)
    tab.plan()
    line = words.timeline(tab.model.timeline)
    assert "".join(part.name for part in line.parts) == "ABABC"
    ((name, begins, ends, depth),) = line.loops
    assert (name, begins, depth) == ("3×", 0.0, 0)
    assert ends == pytest.approx(line.parts[3].ends)
    assert line.parts[-1].ends == pytest.approx(1.0)
    program = tab.model.program
    assert [words.line(program, k) for k in range(3)] == ["", "1 to 2 run 3×", ""]
    alone = replace(program, loops=(Loop(first=2, last=2, times=4),))
    assert words.line(alone, 2) == "runs 4×"
    html = markup.timeline(line._replace(parts=(markup.Span("<i>", 0.0, 1.0),)), "uuid")
    assert "<i>" not in html.replace('<i class="span deep0"', "")
    tab.model.start()
    tab.until(lambda: "Going to waypoint 1 (A). Time 3 of 3." in tab.said)
    tab.model.choose(1)
    with pytest.raises(ConfigError, match="stop the program"):
        tab.model.end_loop()
    tab.until(lambda: tab.model.run is None)
    tab.model.plan("from here")
    tab.until(lambda: tab.model.can_run)
    assert tab.said.startswith("Planned, no collisions. Loops that begin earlier run once.")
    tab.model.end_loop()
    assert tab.model.program.loops == ()
    with pytest.raises(ConfigError, match="is in no loop"):
        tab.model.end_loop()
    tab.model.history.undo()
    assert tab.model.program.loops[0].times == 3


def test_each_step_has_a_speed_and_tells_how_near_it_comes_to_anything(tab):
    tab.record(A, A, B)
    tab.plan()
    full = tab.model.timeline.rehearsal.legs[0].at[-1]
    tab.model.choose(0)
    for speed in (0.9, 0.6, 0.25):  # dragged, and so undone in one go
        tab.set(speed=speed)
    tab.plan()
    tab.model.refresh()
    assert not tab.model.refresh()  # an arm at rest gives nothing new to show
    slow, _, rest = (leg.at[-1] for leg in tab.model.timeline.rehearsal.legs)
    assert 1.4 * full < slow < 4.1 * full  # so short a one is all acceleration
    assert rest < slow
    near = tab.model.timeline.nearest
    assert [*near] == [0, 2]  # the second is where the first is
    assert 0.0 < near[0] < 0.2
    program = tab.model.timeline.rehearsal.program
    assert words.line(program, 0, near[0]) == f"25 % speed, {1000.0 * near[0]:.0f} mm clear"
    assert words.place(np.array([0.3114, -0.16, -0.0001])) == "311, -160, 0 mm"
    tab.model.history.undo()
    assert tab.model.program.waypoints[0].speed == 1.0


def test_a_program_is_planned_and_run_to_its_end_and_a_waypoint_out_of_reach_is_named(tab):
    tab.model.plan()
    tab.record(A, B)
    tab.model.set_rounds(2)
    tab.model.start()
    assert tab.model.run is None, "nothing runs without a plan"
    tab.plan()
    assert tab.model.sentence.tone is Tone.GOOD
    np.testing.assert_array_equal(tab.rig.arm.state.q, np.zeros(5))
    tab.model.start()
    tab.until(lambda: "Going to waypoint 2 (B). Round 1 of 2." in tab.said)
    assert not any((tab.model.waypoint(ARM), tab.model.can_plan, tab.model.can_run))
    with pytest.raises(ConfigError, match="stop the program"):
        tab.model.history.undo()
    with pytest.raises(ConfigError, match="stop the program"):
        tab.model.record_arms()
    tab.until(lambda: tab.model.run is None)
    assert tab.said == "Done 2 times. Press Plan program to run it again."
    np.testing.assert_allclose(tab.rig.arm.state.q, B, atol=to_rad(0.1))
    tab.record(INTO_THE_TABLE)
    tab.model.plan()
    tab.until(lambda: tab.said.startswith("Waypoint 3 (C): "))
    assert tab.model.sentence.tone is Tone.BAD
    assert not tab.model.can_run
    tab.rig.arm.set_torque(False)
    tab.until(lambda: tab.rig.arm.state.mode is Mode.LIMP)
    tab.rig.arm.set_torque(True)
    tab.until(lambda: tab.said == "Press Plan program to check all of it; nothing moves.")


@pytest.mark.parametrize("change", ["arm", "jaw", "speed", "scene", "program"])
def test_whatever_a_plan_was_made_for_changes_drops_it(tab, change):
    tab.record(A)
    tab.plan()
    changes = {
        "arm": lambda: tab.rig.arm.move(JointGoal(q=B), wait=False),
        "jaw": lambda: tab.rig.gripper.move(1.0, wait=False),
        "speed": lambda: tab.rig.arm.set_speed(1.0),
        "scene": lambda: setattr(tab.rig.arm, "scene", Scene()),
        "program": lambda: tab.model.set_rounds(None),
    }
    changes[change]()
    tab.until(lambda: tab.model.timeline is None)
    if change == "arm":
        tab.until(lambda: not tab.model.can_record)
        with pytest.raises(MotionError, match="record it when it stands still"):
            tab.model.record_arms()
    tab.until(lambda: not tab.rig.arm.state.arm_moving and not tab.rig.gripper.is_moving)
    assert "ress Plan program" in tab.said
    assert not tab.model.can_run
    assert tab.model.can_record


def test_guiding_by_hand_ends_by_itself(tab):
    begin = tab.rig.clock.now()  # it is seen some time later
    tab.model.guide()
    tab.until(lambda: tab.model.guided)
    assert "It holds again in" in tab.said
    assert not tab.model.can_plan
    tab.until(lambda: not tab.model.guided)
    assert tab.rig.clock.now() - begin > GUIDED_FOR - 1.0
    assert tab.rig.arm.state.mode is Mode.HOLDING
    assert tab.said == "Hand guiding has timed out. The arm holds where it is."


def test_guiding_by_hand_can_be_ended_by_stop_at_any_time(tab):
    tab.model.guide()
    tab.until(lambda: tab.model.guided)
    stopping = tab.worker.submit(tab.rig.arm.stop)
    tab.until(lambda: not tab.model.guided and stopping.done())
    assert tab.rig.arm.state.mode is Mode.HOLDING
    tab.model.guide()
    tab.until(lambda: tab.model.guided)


def test_a_program_is_kept_and_taken_up_again(tab):
    with pytest.raises(ConfigError, match="record a waypoint first"):
        tab.model.save()
    tab.record(A, B)
    tab.model.set_rounds(None)
    with pytest.raises(ConfigError, match="type a name first"):
        tab.model.save()
    tab.model.name = "stack cubes"
    tab.model.save()
    assert tab.model.saved_files.names == ("stack cubes",)
    tab.model.clear()
    assert len(tab.model.program) == 0
    tab.model.load("stack cubes")
    assert tab.names == "AB"
    assert tab.model.program.rounds is None
    assert tab.said == "Loaded stack cubes, 2 steps. Press Plan program."
    tab.model.delete("stack cubes")
    assert tab.model.saved_files.names == ()
    tab.model.saved_files.undo()
    assert tab.model.saved_files.names == ("stack cubes",)
    tab.model.load("stack cubes")
    assert tab.names == "AB"
    copied = files.file_of("stack cubes").read_bytes()
    files.file_of("another").write_bytes(copied)  # by another program
    tab.until(lambda: tab.model.saved_files.names == ("another", "stack cubes"))


FIRST, SECOND = "arm 1", "arm 2"


class Bench(CellBench):
    """Two arms and the model of their Program tab."""

    def record(self, **targets):
        """Record a step in which arms, by ``first`` and ``second``, go somewhere."""
        names = {"first": FIRST, "second": SECOND}
        for key, q in targets.items():
            self.arms[names[key]].set_target_joints(q)
        self.model.record_targets([names[key] for key in targets])

    def q(self, name):
        return self.opened.rigs[name].arm.state.q


@pytest.fixture
def bench(clock):
    with open_cell(arms_in_a_circle(2), clock=clock) as opened:
        yield Bench(opened, clock, partial(ProgramModel, submit=run_at_once))


def test_stop_ends_it_for_all_arms(bench):
    bench.record(first=aside(70.0), second=aside(70.0))
    assert bench.plan().can_run
    bench.model.start()
    first, second = (rig.arm for rig in bench.opened.rigs.values())
    bench.move(lambda: first.state.arm_moving and second.state.arm_moving)
    with pytest.raises(ConfigError, match="stop the program before you change it"):
        bench.model.remove()
    second.start_stop()
    bench.move(lambda: bench.says("Stopped. Every arm holds where it is; the rest was not run."))
    assert not first.state.arm_moving
    assert not second.state.arm_moving


def test_a_planned_program_is_played_by_ghosts_of_all_arms(bench):
    model = bench.model
    bench.record(first=aside(55.0), second=aside(50.0))
    model.set(SECOND, aperture=1.0)
    model.set(FIRST, pause=60.0)
    bench.record(second=aside(60.0))
    model.set_rounds(2)
    assert bench.plan().can_run
    timeline = model.timeline
    assert [index for _, index, _, _ in timeline.pieces()] == [0, 1, 0]
    assert model.playback.t == timeline.duration
    assert model.active is None
    _, _, began, ended = timeline.pieces()[0]
    assert began == 0.0
    assert ended < 10.0  # a pause of a minute is shown for two seconds
    model.playback.seek(ended)
    assert model.active == 1
    for name, q in ((FIRST, 55.0), (SECOND, 50.0)):
        np.testing.assert_allclose(timeline.at(ended)[1][name].q, aside(q), atol=1e-6)
    opened = bench.opened.rigs[SECOND].gripper.angle_of(1.0)
    assert timeline.at(ended)[1][SECOND].q_jaw == pytest.approx(opened)
    model.playback.play(2.0)
    model.refresh()
    bench.clock.advance(0.1)
    assert model.refresh()
    assert model.playback.t == pytest.approx(ended + 0.2)
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
    model.playback.seek(0.5 * model.timeline.duration)
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
    model.take_target(SECOND)
    assert [*model.program.steps[0]] == [FIRST, SECOND]
    model.set(SECOND, aperture=0.5)
    model.set(SECOND, pause=1.5)
    model.set(FIRST, speed=0.4)
    assert model.waypoint(SECOND).aperture == 0.5
    assert model.waypoint(FIRST).aperture is None
    model.leave_out(FIRST)
    assert model.waypoint(FIRST) is None
    with pytest.raises(ConfigError, match="has no other arm; delete it instead"):
        model.leave_out(SECOND)
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
    bench.record(first=aside(60.0))
    model.remove()  # which says to press Plan program
    arm.set_manual(True)
    model.refresh()
    assert bench.says("Record keeps where arm 2 stands now.")
    assert not model.can_plan
    model.record_arms([SECOND])
    model.choose(0)
    bench.arms[SECOND].set_target_joints(aside(60.0))
    model.take_place(SECOND)
    for step in model.program.steps:
        np.testing.assert_allclose(step[SECOND].q, bench.q(SECOND), atol=to_rad(0.5))
    arm.set_manual(False)
    model.refresh()
    assert model.can_plan
