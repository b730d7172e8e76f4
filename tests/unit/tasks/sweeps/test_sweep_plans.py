"""A data set of plans holds verified motions, the same ones on any executor."""

import json

import numpy as np
import pytest

from so101_motion.arm.gripper import JAW_CLOSED
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.common.units import to_rad
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.sweeps import (
    Atlas,
    CheckSweep,
    PlansSweep,
    check_summary,
    episodes,
    plans_summary,
    run_sweep,
    scene_text,
    write_mcap,
)
from so101_motion.tasks.sweeps.motion_problems import read_problems, scene_of_shard
from so101_motion.tasks.sweeps.plans import PROBLEMS

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


def test_mcap_holds_every_setpoint_of_every_motion_for_other_readers(folder, tmp_path):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    motions, seconds = write_mcap(folder, tmp_path / "all.mcap")
    with (tmp_path / "all.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        read = [(entry[1].topic, entry[3]) for entry in reader.iter_decoded_messages()]
    states = [message for topic, message in read if topic == "/joint_commands"]
    known = list(episodes(folder))
    assert motions == len(known)
    q = to_rad(np.concatenate([each.action[:, :5] for each in known]).astype(float))
    qd = to_rad(np.concatenate([each.velocity for each in known]).astype(float))
    assert np.array([each.position[:5] for each in states]) == pytest.approx(q)
    assert np.array([each.velocity[:5] for each in states]) == pytest.approx(qd)
    assert {each.position[5] for each in states} == {JAW_CLOSED}
    stamps = [each.header.stamp.sec + 1e-9 * each.header.stamp.nanosec for each in states]
    assert np.all(np.diff(stamps) > 0.0)
    assert stamps[-1] + 1.0 == pytest.approx(seconds)
    said = [json.loads(message.data) for topic, message in read if topic == "/motion"]
    assert [each["problem"] for each in said] == [each.problem for each in known]
    scenes = [json.loads(message.data) for topic, message in read if topic == "/scene"]
    assert scenes == [{"obstacles": []}]


def test_mcap_of_some_motions_leaves_the_others_out(folder, tmp_path):
    assert write_mcap(folder, tmp_path / "two.mcap", first=2, count=2)[0] == 2
    with pytest.raises(ConfigError, match="cannot be written"):
        write_mcap(folder, tmp_path / "no" / "such.mcap")
    with pytest.raises(ConfigError, match="has no sweep"):
        write_mcap(tmp_path, tmp_path / "none.mcap")
    assert not (tmp_path / "none.mcap").exists()


def test_it_is_no_atlas(folder):
    with pytest.raises(ConfigError, match="is a sweep of plans"):
        Atlas.read(folder)


def test_motions_are_free_in_their_own_scene_and_some_blocked_by_a_new_box(folder, tmp_path):
    own = CheckSweep.of(folder, scene_text(Scene()))
    run_sweep(own, tmp_path / "own")
    assert check_summary(tmp_path / "own") == ({"motions": 5, "blocked": 0}, [])
    box = Obstacle(
        name="new box",
        shape=Box(size=np.array((0.2, 0.3, 0.3))),
        T_base_obstacle=SE3.from_translation((0.3, 0.0, 0.15)),
    )
    scene = Scene(obstacles=(box,))
    run_sweep(CheckSweep.of(folder, scene_text(scene)), tmp_path / "changed")
    figures, blocked = check_summary(tmp_path / "changed")
    collision = CollisionModel(RobotModel.load(), scene)
    touching = [
        each.problem
        for each in episodes(folder)
        if collision.touching(to_rad(each.action[:, :5].astype(float))).any()
    ]
    assert set(touching) <= set(blocked)
    assert 0 < figures["blocked"] == len(blocked)
    assert any("new box" in name for name in figures)


REST, UP = [0.0, -60.0, 40.0, 50.0, 0.0], [30.0, 0.0, 0.0, 40.0, 0.0]


def test_problems_from_a_file_are_planned_as_they_are(tmp_path):
    problems = [{"start_deg": REST, "goal_deg": UP}, {"start_deg": UP, "goal_deg": [200.0] * 5}]
    file = tmp_path / "problems.json"
    file.write_text(json.dumps({"schema": "so101/problems/1", "problems": problems}))
    given = read_problems(file)
    shard = PlansSweep(count=2, problems=given).open()(0)
    assert np.degrees(shard["start"]) == pytest.approx(np.array([REST, UP]))
    assert shard["why"][0] == ""
    assert shard["why"][1] != ""  # beyond the joint limits
    with pytest.raises(ConfigError, match="count"):
        PlansSweep(count=3, problems=given)
    file.write_text(json.dumps({"schema": "so101/problems/1", "problems": [{"start_deg": REST}]}))
    with pytest.raises(ConfigError, match="problem 0: goal_deg"):
        read_problems(file)


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
