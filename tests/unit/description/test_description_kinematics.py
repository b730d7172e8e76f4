"""The URDF against the official one and against the published module's kinematics."""

import itertools
import json
import struct
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import so101_description as description
from so101_description import PARTS, URDF_PATH
from so101_description.make_allowed_pairs import sample
from so101_description.make_hulls import CORNERS
from so101_description.make_meshes import make
from so101_description.mesh_readers import read_glb

from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.kinematics.model import RobotModel

GEOMETRY = Path(__file__).resolve().parents[2] / "data" / "so101_geometry.json"
JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]

# Official file; the elbow's upper limit is the arm's true stop, 90.8 deg.
LIMITS = {
    "shoulder_pan": (-1.91986, 1.91986),
    "shoulder_lift": (-1.74533, 1.74533),
    "elbow_flex": (-1.69, 1.5848),
    "wrist_flex": (-1.65806, 1.65806),
    "wrist_roll": (-2.74385, 2.84121),
    "gripper": (-0.174533, 1.74533),
}


@pytest.fixture(scope="session")
def geometry() -> dict:
    """Figures of the official arm and of the published module; the file names its sources."""
    return json.loads(GEOMETRY.read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def model():
    return pin.buildModelFromUrdf(str(URDF_PATH))


def frame_pose(model, q, frame):
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.asarray(q, dtype=float))
    return data.oMf[model.getFrameId(frame)]


def rotation_error(R, wxyz):
    w, x, y, z = np.array(wxyz) / np.linalg.norm(wxyz)
    return np.linalg.norm(pin.log3(R.T @ pin.Quaternion(w, x, y, z).matrix()))


def test_names_and_limits_are_the_official_ones_but_for_the_elbow(model):
    assert list(model.names)[1:] == JOINTS
    frames = {frame.name for frame in model.frames}
    assert frames >= {*PARTS, "tool", "jaw_tip"}
    # Masses add up to those of the official arm; the base's is fixed to the universe.
    assert sum(inertia.mass for inertia in model.inertias) == pytest.approx(0.632, abs=1e-3)
    assert model.upperEffortLimit == pytest.approx([1.91] * 6), "these hold for either servo"
    assert model.upperVelocityLimit == pytest.approx([4.71] * 6)
    for i, joint in enumerate(JOINTS):
        limits = (model.lowerPositionLimit[i], model.upperPositionLimit[i])
        assert limits == pytest.approx(LIMITS[joint])
    assert np.degrees(LIMITS["elbow_flex"][1]) == pytest.approx(90.8, abs=0.01)


@pytest.mark.parametrize("case", range(4))
def test_tool_agrees_with_the_published_module(model, geometry, case):
    pose = geometry["published_tool"][case]
    T_base_tool = frame_pose(model, [*pose["q"], 0.0], "tool")
    assert T_base_tool.translation * 1e3 == pytest.approx(pose["p_mm"], abs=0.1)
    assert np.degrees(rotation_error(T_base_tool.rotation, pose["wxyz"])) < 0.02


def test_every_frame_agrees_with_the_official_urdf(model, geometry):
    assert len(geometry["special"]) >= 8
    for name, pose in geometry["special"].items():
        assert len(pose["frames"]) == 8
        for frame, expected in pose["frames"].items():
            T_base_frame = frame_pose(model, pose["q"], frame)
            p, wxyz = expected["p"], expected["wxyz"]
            assert T_base_frame.translation == pytest.approx(p, abs=1e-5), (name, frame)
            assert rotation_error(T_base_frame.rotation, wxyz) < 5e-5, (name, frame)


LINKS = list(description.PARTS)
SUPPORTS = Path(__file__).resolve().parents[2] / "data" / "official_supports.json"


def furthest_outside(hull, points):
    """How far the worst point lies outside the hull, by its half-spaces; negative is inside."""
    a, b, c = (hull.vertices[hull.faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.max(points @ normals.T - np.sum(normals * a, axis=1))


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


def test_named_poses_are_free_of_self_and_floor(geometry):
    collision = CollisionModel(RobotModel.load())
    assert len(geometry["named"]) == 8
    for name, pose in geometry["named"].items():
        *q, q_jaw = np.radians(pose["q_deg"])
        assert collision.clearance(np.array(q), q_jaw).room > 0.0, name
    # LeRobot's shipped rest pose read without its zero offsets: the official solids overlap.
    assert collision.first_contact(np.radians([-4.0, -103.0, 97.0, 78.0, -65.0])) is not None


def test_allowed_pairs_name_links_and_cover_every_hinge():
    allowed = description.load_allowed_pairs()
    known = {*LINKS, description.GROUND}
    assert all(pair <= known and len(pair) == 2 for pair in allowed)
    assert {frozenset(pair) for pair in itertools.pairwise(LINKS)} <= allowed
    assert frozenset(("base_link", description.GROUND)) in allowed
    assert frozenset(("base_link", "gripper_link")) not in allowed


def test_fresh_samples_find_no_overlap_in_a_dropped_pair():
    committed = json.loads(description.ROBOT.allowed_pairs.read_text(encoding="utf-8"))
    fresh = sample(1500, 7)
    for old, new in zip(committed["pairs"], fresh["pairs"], strict=True):
        assert (old["first"], old["second"]) == (new["first"], new["second"])
        assert old["allowed"] <= new["allowed"]
        if old.get("reason") == "never":
            assert new["nearest"] >= old["nearest"] - 5e-4
    found = committed["configurations_with_an_overlap"]
    free = committed["samples"] - found["drawn"]
    assert 0 <= found["hulls"] - found["drawn"] < 0.01 * free, "false alarms are rare"


ALL = [*description.PARTS.values(), *description.MARKERS]


@pytest.mark.parametrize(("link", "part"), description.PARTS.items())
def test_extents_are_within_3_mm_of_the_official_links(geometry, link, part):
    vertices = np.concatenate([s.mesh.vertices for s in description.load_visual(part)]) * 1e3
    low, high = geometry["extents_mm"][link]
    assert vertices.min(axis=0) == pytest.approx(low, abs=3.0)
    assert vertices.max(axis=0) == pytest.approx(high, abs=3.0)


def edges_of(surface):
    """Directed edges after welding vertices that differ in their normal only."""
    _, index = np.unique(surface.mesh.vertices, axis=0, return_inverse=True)
    faces = index.ravel()[surface.mesh.faces]
    return [
        tuple(edge)
        for triangle in faces.tolist()
        for edge in zip(triangle, triangle[1:] + triangle[:1], strict=True)
    ]


@pytest.mark.parametrize("part", ALL)
def test_every_surface_is_watertight_and_faces_outwards(part):
    for surface in description.load_visual(part):
        edges = edges_of(surface)
        there = set(edges)
        assert len(there) == len(edges), surface.name
        assert {(b, a) for a, b in there} == there, surface.name
        a, b, c = (surface.mesh.vertices[surface.mesh.faces[:, i]] for i in range(3))
        assert np.sum(np.cross(a, b) * c) > 0.0, surface.name


def test_meshes_are_light_and_alone_in_their_folder():
    arm = [s for part in description.PARTS.values() for s in description.load_visual(part)]
    assert sum(len(surface.mesh.faces) for surface in arm) <= 30_000
    files = list(description.MESH_DIR.iterdir())
    assert sum(file.stat().st_size for file in files if file.suffix == ".glb") < 1_500_000
    assert sum(file.stat().st_size for file in files) < 2_000_000
    names = {f"{part}.glb" for part in ALL}
    names |= {f"{part}_hull.obj" for part in description.PARTS.values()}
    assert {file.name for file in files} == names


def test_unknown_parts_and_other_files_are_refused_and_arrays_cannot_be_written(tmp_path):
    with pytest.raises(ValueError, match="no part 'elbow'; known: base, shoulder"):
        description.load_visual("elbow")
    with pytest.raises(ValueError, match="no part 'axes'"):
        description.load_hull("axes")
    other = tmp_path / "old.glb"
    other.write_bytes(struct.pack("<III", 0x46546C67, 1, 12))
    with pytest.raises(ValueError, match="not a binary glTF 2"):
        read_glb(other)
    with pytest.raises(ValueError, match="read-only"):
        description.load_visual("jaw")[0].mesh.vertices[0] = 0.0


@pytest.mark.parametrize("part", ["axes", pytest.param("upper_arm", marks=pytest.mark.long)])
def test_making_a_part_again_gives_the_committed_bytes(part, tmp_path):
    make(part, tmp_path)
    again = (tmp_path / f"{part}.glb").read_bytes()
    assert again == (description.MESH_DIR / f"{part}.glb").read_bytes()
