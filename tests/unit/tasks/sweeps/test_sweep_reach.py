"""An atlas of the arm's reach agrees with inverse kinematics and collision checks."""

import math

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError, Unreachable
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.planning.goals import GoalMetric, PoseGoal
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.sweeps import Atlas, ReachSweep, run_sweep, scene_text
from so101_motion.tasks.sweeps.atlas_view import Shown, voxels

COARSE = ReachSweep(spacing=0.08)
WALL = Obstacle(
    name="wall",
    shape=Box(size=np.array((0.02, 0.6, 0.5))),
    T_base_obstacle=SE3.from_translation((0.3, 0.0, 0.25)),
)


@pytest.fixture(scope="module")
def model():
    return RobotModel.load()


@pytest.fixture(scope="module")
def atlas(tmp_path_factory):
    return made(COARSE, tmp_path_factory.mktemp("atlas"))


def made(sweep, folder):
    run_sweep(sweep, folder / "atlas")
    return Atlas.read(folder / "atlas")


def poses(atlas):
    """The best pose of each point that is free, with the point and the row."""
    points = atlas.grid.points(atlas.points)
    for p, row in zip(points, atlas.rows, strict=True):
        if row["ways"]:
            yield p, np.array([row[f"q{joint}"] for joint in range(5)], dtype=float), row


def test_the_best_pose_is_at_its_point_with_the_clearance_that_is_reported(atlas, model):
    collision = CollisionModel(model)
    assert len(list(poses(atlas))) > 100
    for p, q, row in poses(atlas):
        assert model.frame(q).p == pytest.approx(p, abs=1e-6)
        assert model.outside(q, 1e-6) is None
        assert row["clearance"] == pytest.approx(collision.clearance(q).distance, abs=1e-6)


def test_a_point_beyond_the_joint_limits_is_unreachable_by_inverse_kinematics_too(atlas, model):
    """A fan of pitches may pass a point by that is hardly within the limits, the other way not."""
    ik, known = IkSolver(model), set(atlas.points.tolist())
    missed = 0
    for number in range(0, atlas.grid.size, 3):
        p = atlas.grid.points(np.array([number]))[0]
        goal = PoseGoal(T_base_tool=SE3.from_translation(p), metric=GoalMetric.POSITION_ONLY)
        try:
            ik.solve(goal, np.zeros(5))
        except Unreachable:
            assert number not in known
        else:
            missed += number not in known
    assert missed <= 0.02 * len(known)


def test_a_wall_takes_reach_away_and_adds_none(atlas, tmp_path):
    scene = scene_text(Scene(obstacles=(WALL,)))
    walled = made(ReachSweep(spacing=COARSE.spacing, scene=scene), tmp_path)
    assert np.array_equal(walled.points, atlas.points)
    assert np.all(walled.rows["ways"] <= atlas.rows["ways"])
    assert walled.summary()["reachable"] < atlas.summary()["reachable"]


def test_from_above_the_tool_points_down(tmp_path, model):
    down = made(ReachSweep(spacing=0.04, approach=(0.0, 0.0, -1.0)), tmp_path)
    found = [model.frame(q).R[:, 2] for _, q, _ in poses(down)]
    assert len(found) > 100
    assert min(-axis[2] for axis in found) >= math.cos(math.radians(5.0)) - 1e-6


def test_a_payload_leaves_less_torque(atlas, tmp_path):
    heavy = made(ReachSweep(spacing=COARSE.spacing, payload=0.4), tmp_path)
    assert heavy.summary()["free"] == atlas.summary()["free"]
    assert heavy.summary()["reachable"] < atlas.summary()["reachable"]


def test_a_question_is_answered_by_the_nearest_point(atlas):
    good = next(i for i, row in enumerate(atlas.rows) if row["ways"] > 3)
    x, y, z = atlas.grid.points(atlas.points[good : good + 1])[0].tolist()
    answer = atlas.at(x + 0.03, y - 0.03, z + 0.03)
    assert answer.reachable
    assert answer.ways == atlas.rows["ways"][good]
    assert len(answer.q) == 5
    assert len(answer.branch_names) == answer.branches.bit_count() > 0


@pytest.mark.parametrize("p", [(0.0, 0.0, -0.15), (9.0, 0.0, 0.0), (-9.0, 0.0, 0.0)])
def test_nowhere_is_not_reachable(atlas, p):
    assert not atlas.at(*p).reachable


def test_an_atlas_that_is_not_complete_is_refused(tmp_path):
    made(COARSE, tmp_path)
    (tmp_path / "atlas" / "shards" / "000000.npz").unlink()
    with pytest.raises(ConfigError, match="lacks 1 of"):
        Atlas.read(tmp_path / "atlas")


@pytest.mark.parametrize(
    "wrong", [{"spacing": 0.0}, {"spacing": math.nan}, {"approach": (0.0, 0.0, 0.0)}]
)
def test_invalid_input_is_refused(wrong):
    with pytest.raises(ConfigError):
        ReachSweep(**{"spacing": 0.05, **wrong})


# Its picture


def test_a_slice_and_a_threshold_take_away(atlas):
    cut = voxels(atlas, Shown(axis="y", at=0.01))
    assert np.all(np.abs(cut.p[:, 1]) < 1e-9)
    assert cut.total == len(cut.rows)  # all of a slice can be seen
    strong = voxels(atlas, Shown(axis="y", at_least=0.6))
    assert 0 < strong.total < cut.total
    assert np.all(atlas.rows["torque_left"][strong.rows] >= 0.6)
