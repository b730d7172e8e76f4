"""The compiled check: coal's verdicts at any width and in every scene."""

import gc
import shutil
import weakref
from pathlib import Path

import numpy as np
import pytest
from campaign import verdicts
from harness.coal_check import CoalJudge
from harness.random_scenes import random_scene

from so101_motion.common.errors import WorkerError
from so101_motion.common.geometry import SE3
from so101_motion.planning.checkpoint import Abandoned
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Mesh, Obstacle, PointCloud, Scene
from so101_motion.planning.native import library
from so101_motion.planning.native.library import native


@pytest.mark.parametrize("seed", range(4))
def test_verdicts_are_coals_far_from_contact_and_close_to_it(model, seed):
    rng = np.random.default_rng(seed)
    told = verdicts.compare(rng, model, 400)
    assert told["false_free"] == 0
    assert told["false_touching"] == 0
    assert told["by_coal"] < 40, "hardly any is left to coal"


@pytest.mark.parametrize("lanes", [4, 8])
def test_the_width_of_vectors_changes_no_verdict(model, lanes):
    rng = np.random.default_rng(7)
    if native().library.so101_start(lanes) < lanes:
        pytest.skip("this processor has no such vectors")
    try:
        assert verdicts.compare(rng, model, 400)["failures"] == []
    finally:
        native().library.so101_start(native().lanes)


@pytest.mark.parametrize("seed", range(3))
def test_a_motion_is_blocked_where_it_is_by_coal_alone(model, seed):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, held=seed == 1)
    compiled, plain = CollisionModel(model, scene), CoalJudge(model, scene)
    for _ in range(25):
        points = rng.uniform(model.lower, model.upper, (rng.integers(1, 4), 5)) * 0.7
        for how in ({}, {"tolerance": 0.2}, {"bend": 0.0009, "extra": 0.006}):
            found = compiled.first_blocked(points, 0.4, **how)
            expected = plain.first_blocked(points, 0.4, **how)
            assert (found is None) == (expected is None)
            if found is not None:
                np.testing.assert_allclose(found, expected, atol=1e-9)
        sampled, q, q_to = compiled.sampled_check(0.4, spacing=0.02), points[0], points[-1]
        assert sampled.is_clear(q, q_to) == plain.is_clear(q, q_to, 0.4, spacing=0.02)
        assert sampled.is_free(q) == plain.is_free(q, 0.4)


def test_angles_that_are_none_are_never_free(model):
    collision = CollisionModel(model)
    assert not collision.touching(np.zeros((1, 5)))[0]
    for odd in (np.nan, np.inf, -np.inf):
        assert collision.touching(np.array([[0.0, odd, 0.0, 0.0, 0.0]]))[0]


def test_many_cubes_and_many_triangles(model):
    rng = np.random.default_rng(3)
    wall = np.column_stack(
        (np.full(4000, 0.3), rng.uniform(-0.3, 0.3, 4000), rng.uniform(0, 0.4, 4000))
    )
    corners = rng.uniform(-0.1, 0.1, (900, 3))
    scene = Scene(
        obstacles=(
            Obstacle(
                name="wall",
                shape=PointCloud(points=wall, resolution=0.01),
                T_base_obstacle=SE3.from_rpy((0.1, 0.2, 0.3), (0.02, 0.0, 0.0)),
            ),
            Obstacle(
                name="lump",
                shape=Mesh(vertices=corners, triangles=np.arange(900).reshape(-1, 3)),
                T_base_obstacle=SE3.from_translation((0.1, -0.3, 0.2)),
            ),
        )
    )
    q = rng.uniform(model.lower, model.upper, (1000, 5))
    compiled, plain = CollisionModel(model, scene), CoalJudge(model, scene)
    found = compiled.touching(q)
    assert 0.2 < found.mean() < 0.95
    np.testing.assert_array_equal(found, plain.touching(q))


def test_what_the_checkpoint_raises_ends_the_check_and_comes_out(model):
    def give_up():
        if asked:
            raise Abandoned

    asked = []
    collision = CollisionModel(model, Scene(), give_up)
    q = np.zeros((5000, 5))
    asked.append(1)
    with pytest.raises(Abandoned):
        collision.touching(q)
    asked.clear()
    assert not collision.touching(q).any()


def test_its_memory_goes_with_the_model(model):
    collision = CollisionModel(model)
    alive = weakref.ref(collision.batch)
    del collision
    gc.collect()
    assert alive() is None


def test_a_library_of_other_sources_is_not_looked_at(tmp_path):
    for source in library.FOLDER.glob("*.[ch]"):
        shutil.copy(source, tmp_path)
    before = library.library_file(folder=tmp_path)
    assert before.name == library.library_file(folder=tmp_path).name
    with (tmp_path / "edges.c").open("a") as file:
        file.write("/* changed */\n")
    assert library.library_file(folder=tmp_path).name != before.name
    assert library.library_file(machine="aarch64", folder=tmp_path).name.endswith("-aarch64.so")


def test_a_library_that_was_not_built_is_missed_with_the_command_that_builds_it(monkeypatch):
    monkeypatch.setattr(library, "library_file", lambda: Path("nowhere.so"))
    with pytest.raises(WorkerError, match=r"python build_native\.py"):
        library.native.__wrapped__()
