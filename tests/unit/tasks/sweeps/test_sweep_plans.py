"""A data set of plans holds verified motions, the same ones on any executor."""

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.common.units import to_rad
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.sweeps import Atlas, PlansSweep, episodes, plans_summary, run_sweep
from so101_motion.tasks.sweeps.plans import PROBLEMS, scene_of_shard

FEW = PlansSweep(count=5, fps=50)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plans") / "out"
    run_sweep(FEW, folder)
    return folder


def test_every_motion_keeps_limits_and_stays_free(folder):
    model = RobotModel.load()
    collision = CollisionModel(model)
    found = list(episodes(folder))
    assert [each.problem for each in found] == list(range(5))
    for each in found:
        q = to_rad(each.action[:, :5].astype(float))
        assert not collision.touching(q, extra=each.room - 1e-4).any()
        assert np.all(q >= model.lower - 1e-5)
        assert np.all(q <= model.upper + 1e-5)
        assert np.abs(to_rad(each.velocity)).max() <= FEW.velocity + 1e-4
        steps = np.abs(np.diff(q, axis=0))
        assert steps.max() <= FEW.velocity / FEW.fps + 1e-5
        assert np.diff(each.timestamp) == pytest.approx(1.0 / FEW.fps, abs=1e-5)
        assert np.abs(each.velocity[[0, -1]]).max() < 0.1


def test_the_statistics_count_all_problems(folder):
    summary = plans_summary(folder)
    assert summary["problems"] == summary["solved"] == 5
    assert summary["frames"] == sum(len(each.action) for each in episodes(folder))
    assert 0.0 < summary["duration_min_s"] <= summary["duration_median_s"]


def test_a_shard_does_not_depend_on_what_was_planned_before():
    sweep = PlansSweep(count=PROBLEMS + 2)
    fresh, used = sweep.open(), sweep.open()
    used(0)
    first, second = fresh(1), used(1)
    assert first["problem"].tolist() == [PROBLEMS, PROBLEMS + 1]
    assert all(np.array_equal(first[name], second[name]) for name in first)


def test_it_is_no_atlas(folder):
    with pytest.raises(ConfigError, match="is a sweep of plans"):
        Atlas.read(folder)


def test_scattered_obstacles_are_elsewhere_in_each_shard_and_the_same_in_the_same():
    scene = {"obstacles": [{"name": "wall", "box_mm": [9, 9, 9], "position_mm": [200, 50, 40]}]}
    places = [
        np.array(scene_of_shard([scene], 0.05, 3, shard)["obstacles"][0]["position_mm"])
        for shard in (0, 1, 0)
    ]
    assert np.all(places[0] == places[2])
    assert np.any(places[0] != places[1])
    at = np.array(scene["obstacles"][0]["position_mm"])
    assert all(np.all(np.abs(each - at) <= [50.0, 50.0, 0.0]) for each in places)
    assert scene_of_shard([scene], 0.0, 3, 7) is scene
