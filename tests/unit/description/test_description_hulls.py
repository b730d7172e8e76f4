"""The collision hulls: convex, containing, and free where the arm is free."""

import itertools
import json

import numpy as np
import pinocchio as pin
import pytest
import so101_description as description
from so101_description.make_allowed_pairs import FLOOR_Z, sample
from so101_description.make_hulls import box_corners, hull_of, to_obj

LINKS = list(description.PARTS)


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


@pytest.mark.parametrize(("link", "part"), description.PARTS.items())
def test_hull_is_convex_and_contains_boxes_and_visual(link, part):
    hull = description.load_hull(part)
    drawn = [surface.mesh.vertices for surface in description.load_visual(part)]
    tolerance = 1e-9  # m; every coordinate is a whole micrometre
    assert furthest_outside(hull, hull.vertices) < tolerance
    assert furthest_outside(hull, box_corners(link)) < tolerance
    assert furthest_outside(hull, np.concatenate(drawn)) < 1e-8  # stored as float


@pytest.mark.parametrize(("link", "part"), description.PARTS.items())
def test_hull_spans_the_official_extents(geometry, link, part):
    vertices = description.load_hull(part).vertices * 1e3
    low, high = geometry["extents_mm"][link]
    assert np.all(vertices.min(axis=0) <= low)
    assert np.all(vertices.max(axis=0) >= high)


def test_hulls_need_no_thinning():
    for part in description.PARTS.values():
        assert len(description.load_hull(part).vertices) <= 100


@pytest.mark.parametrize(("link", "part"), description.PARTS.items())
def test_making_a_hull_again_gives_the_committed_file(link, part):
    committed = (description.MESH_DIR / f"{part}_hull.obj").read_text(encoding="ascii")
    assert to_obj(hull_of(link), link) == committed


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
    free = committed["samples"] - found["boxes_fine"]
    assert 0 <= found["hulls"] - found["boxes_fine"] < 0.005 * free
    assert found["drawn"] <= found["hulls"]
