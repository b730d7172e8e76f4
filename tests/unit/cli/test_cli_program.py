import json
from concurrent.futures import Future
from types import SimpleNamespace

import numpy as np
import pytest
from harness.command_line import refused

from so101_motion.cli.program import await_end
from so101_motion.common.errors import NoReply
from so101_motion.files.saved_poses import SavedPoses
from so101_motion.tasks.program import Loop, Program, Waypoint, files

A = np.radians([3.0, 0.0, 0.0, 0.0, 0.0])


def save(*waypoints):
    files.write(Program.of_waypoints(waypoints), files.file_of("nod"))


def test_a_saved_program_is_run_by_its_name(told):
    save(Waypoint(name="aside", q=A), Waypoint(name="back", q=np.zeros(5)))
    done = told("run nod --sim --rounds 2 --yes --speed 120")
    assert done["schema"] == "so101/run/1"
    assert (done["waypoints"], done["rounds"]) == (["aside", "back"], 2)
    np.testing.assert_allclose(done["arrived"]["q_deg"], np.zeros(5), atol=0.1)


def test_what_is_passed_is_reported_before_anything_moves(so101):
    save(Waypoint(name="aside", q=A, passes=True), Waypoint(name="back", q=-A))
    result = so101("run nod --sim", input="n\n")
    passed, stopped = result.stderr.splitlines()[:2]
    assert passed.split()[1] == "aside"
    assert passed.endswith(" s  passed")
    assert stopped.endswith(" s")


def test_loops_are_reported_before_anything_moves_and_run(so101, told):
    made = Program.of_waypoints((Waypoint(name="aside", q=A), Waypoint(name="back", q=-A)))
    made = made.with_loop(Loop(first=0, last=1, times=2)).with_loop(Loop(first=1, last=1, times=3))
    files.write(made, files.file_of("nod"))
    loops = [{"from": 1, "to": 2, "times": 2}, {"from": 2, "to": 2, "times": 3}]
    assert told("run nod --sim --yes --speed 120")["loops"] == loops
    lines = so101("run nod --sim", input="n\n").stderr.splitlines()
    assert [line.split()[0] for line in lines[:2]] == ["1", "2"]
    shown = ["steps 2 to 2 3 times in all", "steps 1 to 2 2 times in all"]
    assert [line.strip() for line in lines[2:4]] == shown


def test_a_program_keeps_off_the_obstacles_of_a_scene(so101, tmp_path):
    save(Waypoint(name="aside", q=A))
    box = {"name": "box", "box_mm": [100, 100, 100], "position_mm": [390, 20, 230]}
    scene = tmp_path / "scene.json"
    scene.write_text(json.dumps({"obstacles": [box]}))
    assert "box" in refused(so101("run nod --sim --yes --scene", scene), 5)


def test_a_pose_of_ones_own_can_be_reached(so101, told):
    SavedPoses().save("over the mug", A)
    plan = told("plan --sim --pose", "over the mug")
    np.testing.assert_allclose(plan["q_goal_deg"], np.degrees(A), atol=1e-3)
    assert '"over the mug"' in refused(so101("plan --sim --pose", "over a mug"))


def test_a_servo_that_falls_silent_ends_the_run_though_its_error_is_a_timeout_too():
    run = SimpleNamespace(future=Future[None]())
    run.future.set_exception(NoReply("no reply from servo 3", servo_id=3, register="goal"))
    with pytest.raises(NoReply):
        await_end(run)
