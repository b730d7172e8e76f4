"""A recording opened from a file, without a network or anything else."""

import io
from datetime import datetime

import numpy as np
import pytest
from harness.browser_user import FEW_PICTURES, HOME, READY
from PIL import Image
from so101_viewer import film_of_plan, write_recording

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

HOSTILE = "<img src=x onerror=window.PWNED=1>"


@pytest.fixture(scope="module")
def film(visit, tmp_path_factory):
    shape, place = Box(size=np.full(3, 0.06)), SE3.from_translation((0.1, 0.25, 0.03))
    scene = Scene(obstacles=(Obstacle(name=HOSTILE, shape=shape, T_base_obstacle=place),))
    limits = MotionLimits.uniform(velocity=2.0, acceleration=8.0, jerk=80.0)
    request = PlanRequest(q_start=HOME, goal=JointGoal(q=READY), limits=limits, scene=scene)
    plan = Planner(RobotModel.load()).plan(request)
    path = tmp_path_factory.mktemp("film") / "film.html"
    write_recording(film_of_plan(plan, scene, title=HOSTILE, q_jaw=0.0), path)

    guest = visit((600, 420), script=FEW_PICTURES, offline=True)
    guest.page.goto(path.as_uri())
    guest.page.wait_for_function(
        "() => window.__viserSceneTree && '/arms/0/arm/gripper_link' in "
        "window.__viserSceneTree.getState()"
    )
    return guest


def test_a_film_shows_the_arm_in_motion_and_its_figures_asks_for_nothing_and_runs_no_name(film):
    film.until(lambda: {"/arms/0/ghost/gripper_link", "/arms/0/path", "/world/0"} <= film.nodes())
    before = film.pose_of("/arms/0/arm/gripper_link")["position"]
    film.until(lambda: film.pose_of("/arms/0/arm/gripper_link")["position"] != before)

    film.page.evaluate("window.draws = true")
    film.until(lambda: orange(film.page.screenshot()) > 200)
    film.page.evaluate("window.draws = false")
    for words in ("Duration", "Peak speed", "Clearance", "Limits", "Gripper", HOSTILE):
        film.comes_to(1, film.page.get_by_text(words, exact=True).count)
    for words in ("path of the tool", "the goal", "% open", f"{datetime.now():%Y-%m-%d}"):
        film.until(lambda words=words: film.says(words))
    film.until(lambda: not film.says("WebGL"))  # a developer's words; there is a line of ours
    own = ("file:", "blob:", "data:")
    assert [url for url in film.asked if not url.startswith(own)] == []
    assert film.page.evaluate("window.PWNED") is None
    assert film.problems == []


def orange(png):
    """How many pixels have the colour of the arm."""
    bands = Image.open(io.BytesIO(png)).convert("HSV").split()
    hue, saturation, value = (np.asarray(band, dtype=int) for band in bands)
    return int(((saturation > 120) & (value > 80) & (hue > 12) & (hue < 34)).sum())
