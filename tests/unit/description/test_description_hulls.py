"""The collision hulls: convex, around the official solids, and free where the arm is free."""

import itertools
import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import so101_description as description
from so101_description.make_allowed_pairs import FLOOR_Z, sample
from so101_description.make_hulls import CORNERS, fitted_hull, official_triangles, to_obj
from so101_description.mesh_readers import read_obj

LINKS = list(description.PARTS)
SUPPORTS = Path(__file__).resolve().parents[2] / "data" / "official_supports.json"


def furthest_outside(hull, points):
    """How far the worst point lies outside the hull, by its half-spaces; negative is inside."""
    a, b, c = (hull.vertices[hull.faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.max(points @ normals.T - np.sum(normals * a, axis=1))


class Checker:
    """Hulls as pinocchio loads them from the URDF, with the pairs that need looking at."""

    def __init__(self, model):
        self.model = model
        self.data = model.createData()
        self.geometry = pin.buildGeomFromUrdf(
            model,
            str(description.URDF_PATH),
            pin.COLLISION,
            package_dirs=str(description.URDF_PATH.parent),
        )
        for shape in self.geometry.geometryObjects:
            shape.geometry.buildConvexHull(True, "Qt")
            shape.geometry = shape.geometry.convex
        self.names = [shape.name.removesuffix("_0") for shape in self.geometry.geometryObjects]
        allowed = description.load_allowed_pairs()
        for i, j in itertools.combinations(range(len(self.names)), 2):
            if frozenset((self.names[i], self.names[j])) not in allowed:
                self.geometry.addCollisionPair(pin.CollisionPair(i, j))
        self.reaching = [
            None
            if frozenset((name, description.GROUND)) in allowed
            else description.load_hull(description.PARTS[name]).vertices
            for name in self.names
        ]
        self.state = self.geometry.createData()

    def overlaps(self, q):
        pin.updateGeometryPlacements(self.model, self.data, self.geometry, self.state, q)
        return [
            (self.names[pair.first], self.names[pair.second])
            for i, pair in enumerate(self.geometry.collisionPairs)
            if pin.computeCollision(self.geometry, self.state, i)
        ]

    def height_above_floor(self, q):
        """Of the lowest hull among the links that can reach the floor."""
        pin.updateGeometryPlacements(self.model, self.data, self.geometry, self.state, q)
        heights = [
            hull @ placement.rotation[2] + placement.translation[2] - FLOOR_Z
            for hull, placement in zip(self.reaching, self.state.oMg, strict=True)
            if hull is not None
        ]
        return np.min(np.concatenate(heights))


@pytest.fixture(scope="module")
def checker(model):
    return Checker(model)


@pytest.mark.parametrize("part", description.PARTS.values())
def test_hull_is_convex_has_few_corners_and_contains_what_is_drawn(part):
    hull = description.load_hull(part)
    drawn = [surface.mesh.vertices for surface in description.load_visual(part)]
    assert furthest_outside(hull, hull.vertices) < 1e-9  # every coordinate is a whole micrometre
    assert furthest_outside(hull, np.concatenate(drawn)) < 1e-6
    assert len(hull.vertices) <= CORNERS[part]


@pytest.mark.parametrize(("link", "part"), description.PARTS.items())
def test_hull_contains_the_official_solid_and_stands_out_of_its_hull_by_little(link, part):
    measured = json.loads(SUPPORTS.read_text(encoding="utf-8"))
    directions = spread_directions(measured["count"])
    beyond = np.max(description.load_hull(part).vertices @ directions.T, axis=0)
    beyond -= 1e-3 * np.array(measured["supports_mm"][link])
    assert np.all(beyond > -0.5e-6)  # as they are rounded
    assert np.all(beyond < 0.8e-3)
    assert np.mean(beyond) < 0.5e-3


def spread_directions(count):
    """Unit vectors all over the sphere, on a Fibonacci spiral, shape (count, 3)."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, k * np.pi * (1.0 + np.sqrt(5.0))
    across = np.sqrt(1.0 - z * z)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


def test_fitting_finds_few_corners_around_many_points():
    ellipsoid = spread_directions(700) * [0.05, 0.03, 0.02]
    hull = fitted_hull(ellipsoid, 40)
    assert len(hull.vertices) <= 40
    assert furthest_outside(hull, ellipsoid) <= 0.0
    directions = spread_directions(100)
    beyond = np.max(hull.vertices @ directions.T, axis=0)
    beyond -= np.max(ellipsoid @ directions.T, axis=0)
    assert np.max(beyond) < 2.5e-3


def test_official_triangles_are_read_into_their_links_frame(tmp_path):
    row = np.zeros(1, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("a", "<u2")]))
    row["corners"] = np.eye(3)
    (tmp_path / "part.stl").write_bytes(bytes(84) + row.tobytes())
    visual = (
        '<visual><origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/>'
        '<geometry><mesh filename="part.stl"/></geometry></visual>'
    )
    (tmp_path / "so101_new_calib.urdf").write_text(
        f'<robot name="r"><link name="a">{visual}</link><link name="b"/></robot>'
    )
    triangles = official_triangles(tmp_path)
    assert list(triangles) == ["a"]
    expected = [[[1.0, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 1.0]]]
    np.testing.assert_allclose(triangles["a"], expected, atol=1e-12)


def test_a_hull_is_read_back_as_it_was_written(tmp_path):
    hull = description.load_hull("jaw")
    (tmp_path / "again.obj").write_text(to_obj(hull, "jaw"))
    again = read_obj(tmp_path / "again.obj")
    np.testing.assert_array_equal(again.vertices, hull.vertices)
    np.testing.assert_array_equal(again.faces, hull.faces)


def test_pinocchio_loads_one_convex_shape_a_link(checker):
    assert checker.names == LINKS
    for name, shape in zip(checker.names, checker.geometry.geometryObjects, strict=True):
        hull = description.load_hull(description.PARTS[name])
        loaded = np.array(shape.geometry.points())
        assert furthest_outside(hull, loaded) == pytest.approx(0.0, abs=1e-8)  # read as float
        directions = np.random.default_rng(0).normal(size=(3, 200))
        reach = np.max(hull.vertices @ directions, axis=0)
        assert np.max(loaded @ directions, axis=0) == pytest.approx(reach, abs=1e-7)


def test_named_poses_are_free_of_self_and_floor(checker, geometry):
    assert len(geometry["named"]) == 8
    for name, pose in geometry["named"].items():
        q = np.radians(pose["q_deg"])
        assert checker.overlaps(q) == [], name
        assert checker.height_above_floor(q) > 0.03, name


def test_folded_beyond_the_stops_overlaps(checker):
    # LeRobot's shipped rest pose read without its zero offsets: the official solids overlap.
    assert checker.overlaps(np.radians([-4.0, -103.0, 97.0, 78.0, -65.0, 0.0]))


@pytest.mark.parametrize("reach", [0.12, 0.16, 0.20, 0.22])
@pytest.mark.parametrize("tip_height", [0.006, 0.010, 0.020])
def test_tool_down_near_the_floor_is_not_refused(model, checker, reach, tip_height):
    q = tool_down(model, reach, tip_height)
    assert checker.overlaps(q) == []
    assert checker.height_above_floor(q) > 0.0


def tool_down(model, reach, tip_height):
    """Joint angles with the jaw tip at a distance from the pan axis, pointing straight down."""
    target = np.array([0.0388353 + reach, tip_height])
    data = model.createData()
    frame = model.getFrameId("jaw_tip")
    for lift, elbow in itertools.product(np.radians([-60, -20, 20]), np.radians([0, 40, 80])):
        bend = np.array([lift, elbow])
        for _ in range(60):
            q = np.array([0.0, bend[0], bend[1], np.pi / 2 - bend.sum(), 0.0, 0.0])
            pin.computeJointJacobians(model, data, q)
            pin.updateFramePlacements(model, data)
            error = target - data.oMf[frame].translation[[0, 2]]
            J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[[0, 2]]
            J = J[:, 1:3] - J[:, 3:4]
            bend = bend + J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(2), error)
        inside = np.all(q >= model.lowerPositionLimit) and np.all(q <= model.upperPositionLimit)
        if np.linalg.norm(error) < 1e-6 and inside:
            return q
    raise AssertionError("the arm cannot point straight down there")


def test_allowed_pairs_name_links_and_cover_every_hinge():
    allowed = description.load_allowed_pairs()
    known = {*LINKS, description.GROUND}
    assert all(pair <= known and len(pair) == 2 for pair in allowed)
    assert {frozenset(pair) for pair in itertools.pairwise(LINKS)} <= allowed
    assert frozenset(("base_link", description.GROUND)) in allowed
    assert frozenset(("base_link", "gripper_link")) not in allowed


def test_fresh_samples_find_no_overlap_in_a_dropped_pair():
    committed = json.loads(description.ALLOWED_PAIRS_PATH.read_text(encoding="utf-8"))
    fresh = sample(1500, 7)
    for old, new in zip(committed["pairs"], fresh["pairs"], strict=True):
        assert (old["first"], old["second"]) == (new["first"], new["second"])
        assert old["allowed"] <= new["allowed"]
        if old.get("reason") == "never":
            assert new["nearest"] >= old["nearest"] - 5e-4


def test_false_alarms_are_rare_and_there_are_no_misses():
    committed = json.loads(description.ALLOWED_PAIRS_PATH.read_text(encoding="utf-8"))
    found = committed["configurations_with_an_overlap"]
    free = committed["samples"] - found["drawn"]
    assert 0 <= found["hulls"] - found["drawn"] < 0.01 * free
