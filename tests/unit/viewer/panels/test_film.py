import json
import re
from dataclasses import replace
from datetime import datetime
from types import SimpleNamespace

import numpy as np
import pytest
from so101_viewer.page.plan_view import plan_view
from so101_viewer.page.target_ik import TargetSolver
from so101_viewer.panels.film import (
    FRAMES,
    Film,
    MovedArm,
    film_of_plan,
    recording,
    write_recording,
)
from so101_viewer.panels.share_panel import FILM, KINDS, content, file_name
from so101_viewer.scene.scene_edits import holder_of

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.files.trajectory_export import Run
from so101_motion.planning.collision.scene import Attached, Obstacle, Scene, Sphere
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

HOSTILE = '</title><script>window.PWNED = 1</script><img src=x onerror="window.PWNED = 1">'

SCENE = Scene(
    obstacles=(
        Obstacle(
            name=HOSTILE,
            shape=Sphere(radius=0.03),
            T_base_obstacle=SE3.from_translation((0.0, 0.3, 0.05)),
        ),
    ),
    attached=(
        Attached(
            name="held",
            shape=Sphere(radius=0.01),
            T_tool_object=SE3.from_translation((0.0, 0.0, 0.1)),
        ),
    ),
)

NOW = datetime(2026, 11, 21, 19, 30, 5)
RUN_OF_TWO = Run(t=np.array([0.0, 5.0]), q_ref=np.ones((2, 5)), q=np.full((2, 5), 0.9))


@pytest.fixture(scope="module")
def plan():
    request = PlanRequest(
        q_start=np.zeros(5),
        goal=JointGoal(q=np.array([0.6, -0.5, 0.4, 0.5, 0.0])),
        limits=MotionLimits.uniform(velocity=2.0, acceleration=8.0, jerk=80.0),
        scene=SCENE,
    )
    return Planner(RobotModel.load()).plan(request)


@pytest.fixture(scope="module")
def film(plan):
    return film_of_plan(plan, SCENE, title=HOSTILE, q_jaw=0.0)


def test_a_film_goes_from_the_start_to_the_goal_in_even_steps(film, plan):
    t = film.times()
    q, q_ghost = film.arms[""].at(t)
    assert t[0] == 0.0
    assert t[-1] == plan.trajectory.t[-1]
    assert np.all(np.diff(t) <= 1.0 / FRAMES + 1e-9)
    np.testing.assert_allclose(q[[0, -1]], [plan.q_start, plan.q_goal], atol=1e-6)
    np.testing.assert_allclose(q_ghost, np.broadcast_to(plan.q_goal, q.shape))
    told = dict(film.facts())
    assert {"Motion", "Duration", "Peak speed", "Clearance", "Orange line"} <= set(told)
    assert told["Limits"] == "115 °/s, 458 °/s²"
    assert told["Gripper"].endswith("% open")


def test_a_recording_asks_for_nothing_runs_no_name_and_is_dark_where_its_browser_is(film, tmp_path):
    page = recording(film).decode()
    assert page.count("darkMode:matchMedia('(prefers-color-scheme: dark)').matches") == 1
    assert "{darkMode:false}" not in page
    head = page[: page.index("</head>")]
    assert "default-src 'none'" in head
    assert "http" not in re.search(r'content="(default-src[^"]*)"', head).group(1)
    assert "<script>window.PWNED" not in page
    assert "&lt;script&gt;window.PWNED" in page
    assert len(page) < 2_000_000
    with pytest.raises(ConfigError, match=r"must end with \.html"):
        write_recording(film, tmp_path / "film.mp4")
    with pytest.raises(ConfigError, match="cannot be written"):
        write_recording(film, tmp_path / "no" / "folder" / "film.html")


def test_a_film_of_several_arms_has_them_where_they_stand_with_what_they_hold(plan):
    there = SE3.from_rpy((0.0, 0.0, np.pi), (0.35, 0.0, 0.02))
    one = MovedArm(view=_seen(plan), T_scene_base=there)
    other = MovedArm(view=_seen(plan, replace(SCENE, attached=())), run=RUN_OF_TWO)
    film = Film(title="Two arms", arms={"arm 1": one, "arm 2": other})
    assert film.times()[-1] == 5.0  # the longer of the two
    np.testing.assert_allclose(film.arms["arm 1"].at(film.times())[0][-1], plan.q_goal, atol=1e-6)
    measured, q_ghost = film.arms["arm 2"].at(film.times())  # of a run, the ghost as planned
    np.testing.assert_allclose(measured, 0.9)
    np.testing.assert_allclose(q_ghost, 1.0)
    assert [holder_of(each) for each in film.scene().attached] == ["arm 1"]
    [ball] = film.scene().obstacles
    np.testing.assert_allclose(ball.T_base_obstacle.p, [0.35, -0.3, 0.07], atol=1e-12)
    assert film.scene().floor_z == pytest.approx(SCENE.floor_z + 0.02)
    told = dict(film.facts())
    assert " s, clearance " in told["arm 1"]
    assert " s, clearance " in told["arm 2"]


def _seen(plan, scene=SCENE):
    solver = TargetSolver(scene, (np.full(5, -3.0), np.full(5, 3.0)))
    return plan_view(plan, solver, "tool", scene=scene, q_jaw=0.0)


@pytest.fixture
def arm(plan):
    return MovedArm(view=SimpleNamespace(plan=plan))


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != FILM])
def test_each_kind_of_file_has_something_in_it_for_a_plan(arm, kind):
    assert len(content(arm, kind)) > 1000


def test_names_of_files_tell_kinds_plans_and_arms_apart(arm):
    ran = replace(arm, run=RUN_OF_TWO)
    kind = "JSON, degrees"
    assert file_name(arm, kind, NOW) == "so101-plan-20261121-193005.json"
    assert file_name(ran, kind, NOW) == "so101-run-20261121-193005.json"
    assert json.loads(content(ran, kind))["schema"] == "so101/run/1"
    assert len({file_name(arm, each, NOW) for each in KINDS}) == len(KINDS)
    name = "so101-plan-20261121-193005-arm-2-b.json"
    assert file_name(arm, kind, NOW, chosen="arm 2/b") == name
    assert file_name(arm, FILM, NOW, chosen="arm 2/b") == "so101-plan-20261121-193005.html"
