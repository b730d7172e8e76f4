import gc
import shutil
import weakref
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import so101_description
from campaign import verdicts
from harness.coal_check import CoalJudge
from harness.random_scenes import obstacle, random_scene

from so101_motion.common.errors import WorkerError
from so101_motion.common.geometry import SE3
from so101_motion.native import library
from so101_motion.native.library import native
from so101_motion.planning.collision.bodies import bodies_in
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import (
    LINKS,
    Attached,
    Box,
    Capsule,
    Mesh,
    Obstacle,
    PointCloud,
    Scene,
    Sphere,
)


def configuration(*angles_deg):
    return np.radians(angles_deg[:5])


BELOW = configuration(0, 60, 20, 40, 0)  # the hand reaches 13 cm below the table


def random_configurations(model, count, seed=0):
    return np.random.default_rng(seed).uniform(model.lower, model.upper, (count, 5))


def test_an_arm_folded_too_far_touches_itself_and_a_jaw_below_the_table_the_floor(collision):
    assert {*collision.first_contact(configuration(0, -100, 90, 90, 0))} <= {*LINKS}
    assert collision.first_contact(BELOW) == ("jaw", "floor")
    closest = collision.clearance(BELOW)
    assert closest.distance < -0.02
    assert closest.message().startswith("the jaw would be ")
    assert closest.message().endswith(" mm into the floor")
    assert " mm from the " in collision.clearance(np.zeros(5)).message("is")
    assert collision.first_blocked(np.zeros((1, 5))) is None  # motions of one posture
    assert collision.first_blocked(np.zeros((3, 5))) is None
    assert np.array_equal(collision.first_blocked(BELOW[None]), BELOW)


def test_the_floor_is_where_the_scene_says_and_the_base_may_stand_on_it(model):
    nowhere = CollisionModel(model, Scene(floor_z=None))
    assert nowhere.is_free(BELOW)
    assert not any("floor" in pair for pair in nowhere.pairs)
    assert CollisionModel(model, Scene(floor_z=0.05)).is_free(np.zeros(5))


def test_the_closest_pair_is_the_one_with_the_least_room_by_coal(model):
    post = obstacle("post", (0.04, 0.04, 0.3), (0.25, 0.1, 0.15))
    for scene in (Scene(), Scene(obstacles=(post,), margin=0.01)):
        collision = CollisionModel(model, scene)
        for q in random_configurations(model, 150):
            closest = collision.clearance(q)
            rooms = collision.distances(q) - collision.margins
            assert closest.room == pytest.approx(rooms.min(), abs=1e-6)
            assert (closest.first, closest.second) == collision.pairs[int(np.argmin(rooms))]


def test_near_pairs_are_asked_for_within_reason(collision):
    assert collision.nearest(np.zeros(5), within=0.05) == []
    for within in (0.0, -0.01, 0.2, float("nan")):
        with pytest.raises(ValueError, match=r"within must be more than 0 and at most 0\.1 m"):
            collision.nearest(np.zeros(5), within=within)


def test_a_look_may_ask_for_more_than_the_margin(model, collision):
    for q in random_configurations(model, 300, seed=4):
        room = collision.clearance(q).room
        if min(abs(room), abs(room - 0.01)) > 1e-5:
            assert collision.sampled_check(spacing=0.02).is_free(q) == (room > 0.0)
            assert collision.sampled_check(spacing=0.02, extra=0.01).is_free(q) == (room > 0.01)


def test_with_a_tolerance_a_motion_may_come_a_little_nearer(collision):
    def along_the_floor(distance):
        """A turn of the pan at a height over the table."""
        q = configuration(0, -20, 20, 60, 0)
        while collision.clearance(q).distance > distance:
            q[1] += 2e-4
        return np.array([q, q + np.eye(5)[0] * 0.3])

    assert collision.first_blocked(along_the_floor(0.0031)) is None
    assert collision.first_blocked(along_the_floor(0.0027)) is not None
    assert collision.first_blocked(along_the_floor(0.0027), tolerance=0.2) is None
    assert collision.first_blocked(along_the_floor(0.002), tolerance=0.2) is not None


# The library beside coal


@pytest.mark.parametrize("lanes", [4, 8])
def test_the_width_of_vectors_changes_no_verdict(model, lanes):
    rng = np.random.default_rng(7)
    if native().library.so101_start(lanes) < lanes:
        pytest.skip("this processor has no such vectors")
    try:
        assert verdicts.compare(rng, model, 400) == []
    finally:
        native().library.so101_start(native().lanes)


@pytest.mark.parametrize("seed", range(2))
def test_a_motion_is_free_between_samples_too_or_blocked_where_coal_finds_too_little_room(
    model, seed
):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, held=seed == 1)
    compiled, plain = CollisionModel(model, scene), CoalJudge(model, scene)
    for _ in range(8):
        points = rng.uniform(model.lower, model.upper, (2, 5)) * 0.7
        for how in ({}, {"tolerance": 0.2}, {"bend": 0.0009, "extra": 0.006}):
            bend, extra = how.get("bend", 0.0), how.get("extra", 0.0)
            blocked = compiled.first_blocked(points, 0.4, **how)
            if blocked is None:
                dense = np.linspace(*points, 60)
                assert min(plain.distances(q, 0.4).min() for q in dense) > bend
            else:
                least = (1.0 - how.get("tolerance", 0.0)) * plain.margins + bend + extra
                assert (plain.distances(blocked, 0.4) < least + 1e-6).any()


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
    q = rng.uniform(model.lower, model.upper, (40, 5))
    compiled, plain = CollisionModel(model, scene), CoalJudge(model, scene)
    found = compiled.touching(q)
    assert 0.2 < found.mean() < 0.95
    np.testing.assert_array_equal(found, plain.touching(q))


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


# Every shape at known distances, and which pairs of bodies are checked


READY = np.radians([0, -45, 45, 60, 0])
DISTANCES = [0.0005, 0.002, 0.004, 0.02]


UNIT_CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def cube_mesh(edge):
    faces = [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]  # fmt: skip
    return Mesh(vertices=0.5 * edge * UNIT_CUBE, triangles=faces)


def full_cube(cells, edge):
    """Points in the middle of ``cells`` cubes in each direction around the origin."""
    steps = (np.arange(-cells // 2, cells // 2) + 0.5) * edge
    grid = np.stack(np.meshgrid(steps, steps, steps), axis=-1)
    return PointCloud(points=grid.reshape(-1, 3), resolution=edge)


# Shapes, and how far from their origin they reach along their own x axis; all have a face, or the
# only point, there.
SHAPES = {
    "box": (Box(size=(0.06, 0.2, 0.2)), 0.03),
    "sphere": (Sphere(radius=0.025), 0.025),
    "capsule lying": (Capsule(radius=0.02, length=0.1), 0.02),
    "ball of a capsule": (Capsule(radius=0.02, length=0.04), 0.02),
    "mesh": (cube_mesh(0.08), 0.04),
    "cloud": (full_cube(8, 0.01), 0.04),
}


def frame_along(direction):
    """A rotation whose x axis is ``direction``."""
    x = direction / np.linalg.norm(direction)
    y = np.cross([0.3, -0.5, 0.8], x)
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def outermost(model, q, direction, q_jaw=0.0):
    """The vertex of the arm that is furthest in a direction, and the link it belongs to."""
    best = None
    for link, T in model.link_placements(q, q_jaw).items():
        points = T @ so101_description.load_hull(so101_description.PARTS[link]).vertices
        point = points[np.argmax(points @ direction)]
        if best is None or point @ direction > best[0] @ direction:
            best = point, so101_description.PARTS[link].replace("_", " ")
    return best


def beside(model, q, shape, reach, distance, direction):
    """An obstacle whose surface is so far from the arm's outermost vertex in a direction."""
    direction = direction / np.linalg.norm(direction)
    vertex, link = outermost(model, q, direction)
    R = frame_along(-direction)
    pose = SE3(R, vertex + (distance + reach) * direction)
    return Obstacle(name="thing", shape=shape, T_base_obstacle=pose), link


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("name", SHAPES)
def test_the_distance_to_a_shape_is_the_one_it_was_placed_at(model, name, distance):
    shape, reach = SHAPES[name]
    rng = np.random.default_rng(3)
    for _ in range(2):
        direction = rng.standard_normal(3)
        direction[0] = abs(direction[0]) + 1.0  # ahead, where the hand is
        obstacle, link = beside(model, READY, shape, reach, distance, direction)
        collision = CollisionModel(model, Scene(obstacles=(obstacle,), floor_z=None))
        closest = collision.clearance(READY)
        assert (closest.first, closest.second) == (link, "thing")
        assert closest.distance == pytest.approx(distance, abs=2e-6)
        assert collision.is_free(READY) == (distance > collision.margin)
        near = collision.nearest(READY, within=0.05)[0]
        assert near.distance == pytest.approx(distance, abs=2e-6)


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_inside_the_arm_is_reported_as_a_depth(model, name):
    shape, reach = SHAPES[name]
    obstacle, link = beside(model, READY, shape, reach, -0.002, np.array([1.0, 0.1, 0.2]))
    collision = CollisionModel(model, Scene(obstacles=(obstacle,), floor_z=None))
    assert not collision.is_free(READY)
    closest = collision.clearance(READY)
    assert closest.distance < 0.0
    depth = -closest.distance * 1e3
    assert closest.message() == f"the {link} would be {depth:.1f} mm into 'thing'"


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("name", SHAPES)
def test_what_is_held_is_as_far_from_the_floor_as_its_lowest_point(model, name, distance):
    shape, reach = SHAPES[name]
    T_base_tool = model.frame(READY)
    # Its x axis up, ahead of the fingers, with its lower face above the floor.
    R = frame_along(np.array([0.0, 0.0, 1.0]))
    there = SE3(R, np.array([0.33, 0.1, distance + reach]))
    thing = Attached(name="thing", shape=shape, T_tool_object=T_base_tool.inverse @ there)
    collision = CollisionModel(model, Scene(attached=(thing,), floor_z=0.0))
    k = collision.pairs.index(("thing", "floor"))
    assert collision.distances(READY)[k] == pytest.approx(distance, abs=1e-6)
    assert collision.is_free(READY) == (distance > collision.margin)


def pen(**settings):
    return Attached(
        name="pen",
        shape=Capsule(radius=0.005, length=0.14),
        T_tool_object=SE3.from_rpy((np.pi / 2, 0, 0), (0.0, 0.0, 0.09)),
        **settings,
    )


def test_links_obstacles_and_what_is_held_are_checked_against_all_that_they_may_not_touch(model):
    obstacle, _ = beside(model, READY, *SHAPES["box"], 0.02, np.array([1.0, 0.0, 0.0]))
    pairs = CollisionModel(model, Scene(obstacles=(obstacle,), attached=(pen(),))).pairs
    others = {pair[1] for pair in pairs if pair[0] == "pen"}
    assert others == {*LINKS, "floor", "thing"} - {"gripper", "jaw"}
    near = {pair[0] for pair in pairs if pair[1] == "thing"}
    assert near >= {"upper arm", "lower arm", "wrist", "gripper", "jaw", "pen"}
    names = {link: part.replace("_", " ") for link, part in so101_description.PARTS.items()}
    allowed = {frozenset(map(names.get, each)) for each in so101_description.load_allowed_pairs()}
    every = {frozenset(each) for each in combinations(LINKS, 2)}
    assert {frozenset(each) for each in pairs if {*each} <= {*LINKS}} == every - allowed


def test_what_may_touch_is_not_checked(model):
    obstacle, _ = beside(model, READY, *SHAPES["box"], 0.02, np.array([1.0, 0.0, 0.0]))
    scene = Scene(
        obstacles=(obstacle,),
        attached=(pen(may_touch=frozenset({"thing", "wrist"})),),
        may_touch=frozenset({frozenset({"jaw", "floor"}), frozenset({"base", "jaw"})}),
    )
    pairs = {frozenset(pair) for pair in CollisionModel(model, scene).pairs}
    every = {frozenset(pair) for pair in CollisionModel(model, Scene(
        obstacles=(obstacle,), attached=(pen(),))).pairs}  # fmt: skip
    allowed = [("pen", "thing"), ("pen", "wrist"), ("jaw", "floor"), ("base", "jaw")]
    assert every - pairs == {frozenset(pair) for pair in allowed}


def test_an_obstacle_may_stand_in_the_base(model):
    table = obstacle("table", (1.0, 1.0, 0.05), (0.0, 0.0, -0.02))
    assert CollisionModel(model, Scene(obstacles=(table,))).is_free(READY)


def test_a_wide_margin_counts_for_the_scene_and_not_between_links(model):
    q = np.radians([0, -95, 80, 65, 0])  # folded: 10 mm between the links
    wide = CollisionModel(model, Scene(margin=0.02))
    assert wide.is_free(q)
    links = [k for k, pair in enumerate(wide.pairs) if set(pair) <= set(LINKS)]
    assert set(wide.margins[links]) == {0.003}
    others = np.delete(wide.margins, links)
    assert set(others) == {0.02}


def test_what_is_held_and_flat_has_a_body_too(model):
    sheet = Mesh(
        vertices=[[0, 0, 0], [0.1, 0, 0], [0.1, 0.05, 0], [0, 0.05, 0]],
        triangles=[[0, 1, 2], [0, 2, 3]],
    )
    T_base_tool = model.frame(READY)
    there = SE3.from_translation((0.33, 0.1, 0.01))
    paper = Attached(name="paper", shape=sheet, T_tool_object=T_base_tool.inverse @ there)
    collision = CollisionModel(model, Scene(attached=(paper,), floor_z=0.0))
    k = collision.pairs.index(("paper", "floor"))
    assert collision.distances(READY)[k] == pytest.approx(0.01, abs=5e-4)


# How far a motion moves what is on a link


STICK = Attached(
    name="stick",
    shape=Box(size=(0.02, 0.3, 0.03)),
    T_tool_object=SE3.from_translation((0.02, 0.05, 0.12)),
)
HULLS = {
    link: so101_description.load_hull(part).vertices
    for link, part in so101_description.PARTS.items()
}
CORNERS = UNIT_CUBE * [0.01, 0.15, 0.015]


def arm_points(model, q, q_jaw, attached):
    """All vertices of all links, and of what is held, in base."""
    placed = model.link_placements(q, q_jaw)
    points = [T @ HULLS[link] for link, T in placed.items()]
    if attached:
        points.append(model.frame(q) @ STICK.T_tool_object @ CORNERS)
    return np.concatenate(points)


@pytest.mark.parametrize("attached", [(), (STICK,)], ids=["empty hand", "stick"])
def test_no_vertex_moves_further_than_the_bound_on_travel(model, attached):
    scene = Scene(attached=attached)
    collision, levers = CollisionModel(model, scene), bodies_in(model.pin_model, scene).levers
    rng = np.random.default_rng(2)
    share = 0.0
    for _ in range(400):
        begin = rng.uniform(model.lower, model.upper)
        step = rng.normal(0.0, 0.2, 5) * (rng.random(5) < 0.5)
        end = np.clip(begin + step, model.lower, model.upper)
        q_jaw = float(rng.uniform(-0.17, 1.74))
        before, after = (arm_points(model, q, q_jaw, attached) for q in (begin, end))
        moved = float(np.linalg.norm(after - before, axis=1).max())
        bound = float(np.abs(end - begin) @ levers.at(q_jaw))
        assert moved <= bound + 1e-12
        assert bound <= collision.travel(np.array([begin, end]))[-1] + 1e-12
        share = max(share, moved / bound if bound else 0.0)
    assert share > 0.6, "the bound is no tighter than it need be"
