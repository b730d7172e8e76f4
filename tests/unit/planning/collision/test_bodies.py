"""Every shape at known distances, and which pairs of bodies are checked."""

import numpy as np
import pytest
import so101_description
from harness.random_scenes import obstacle

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.bodies import bodies_in
from so101_motion.planning.collision.coal_shapes import full_cubes
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
    for _ in range(10):
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
        assert near.normal == pytest.approx(direction / np.linalg.norm(direction), abs=1e-2)
        assert near.p_second - near.p_first == pytest.approx(distance * near.normal, abs=1e-6)


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


def test_a_held_object_is_checked_against_all_but_its_holder(model):
    obstacle, _ = beside(model, READY, *SHAPES["box"], 0.02, np.array([1.0, 0.0, 0.0]))
    pairs = CollisionModel(model, Scene(obstacles=(obstacle,), attached=(pen(),))).pairs
    others = {pair[1] for pair in pairs if pair[0] == "pen"}
    assert others == {*LINKS, "floor", "thing"} - {"gripper", "jaw"}


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


def test_pairs_that_cannot_come_near_are_not_checked(model):
    def near(x, radius):
        at = SE3.from_translation((x, 0, 0.1))
        ball = Obstacle(name="ahead", shape=Sphere(radius=radius), T_base_obstacle=at)
        pairs = CollisionModel(model, Scene(obstacles=(ball,))).pairs
        return {pair[0] for pair in pairs if pair[1] == "ahead"}

    assert near(0.9, 0.2) == set()
    just_there = near(0.5, 0.02)  # where the stretched arm only just arrives
    assert {"jaw", "gripper", "wrist"} <= just_there
    assert not {"shoulder", "base"} & just_there


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


def test_the_cubes_of_a_cloud_are_those_that_hold_its_points():
    for seed, count in enumerate((1, 50, 100_000)):
        random = np.random.default_rng(seed)
        cloud = PointCloud(points=random.uniform(-0.3, 0.5, (count, 3)), resolution=0.007)
        cubes = np.unique(np.floor(cloud.points / 0.007), axis=0)
        found = full_cubes(cloud)
        assert found.shape == cubes.shape
        np.testing.assert_allclose(found, (cubes + 0.5) * 0.007, atol=1e-12)


def test_leaving_out_what_lies_out_of_reach_in_a_cloud_changes_no_distance(model):
    random = np.random.default_rng(0)
    room = random.uniform(2.0, 3.0, (200_000, 3))
    here = np.array([[0.2, 0.0, 0.1]])

    def seen(points):
        cloud = PointCloud(points=points, resolution=0.01)
        thing = Obstacle(name="cloud", shape=cloud, T_base_obstacle=SE3.identity())
        return CollisionModel(model, Scene(obstacles=(thing,)))

    alone, among = seen(here), seen(np.concatenate([room, here, -room]))
    for q in random.uniform(model.lower, model.upper, (20, 5)):
        assert np.array_equal(alone.distances(q), among.distances(q))


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


def test_what_is_held_reaches_further(model):
    empty, full = CollisionModel(model), CollisionModel(model, Scene(attached=(STICK,)))
    assert np.all(full.reach >= empty.reach)
    assert full.reach[4] == pytest.approx(0.2, abs=0.02)


def test_an_open_jaw_reaches_further_around_the_roll(model):
    levers = bodies_in(model.pin_model, Scene()).levers
    assert levers.at(1.7)[4] > 2.0 * levers.at(0.0)[4]
    assert np.all(levers.longest >= levers.at(0.7))
