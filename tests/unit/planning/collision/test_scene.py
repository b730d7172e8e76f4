import struct
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from harness.coal_check import CoalJudge

from so101_motion.common.errors import ConfigError, InCollision
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import (
    Attached,
    Box,
    Capsule,
    Mesh,
    Obstacle,
    PointCloud,
    Scene,
    Sphere,
    StandingArm,
)
from so101_motion.planning.collision.shape_files import (
    MOST_POINTS,
    MOST_TRIANGLES,
    coarse,
    file_mesh,
    holds_faces,
    mesh_kind,
    read_cloud,
    read_mesh,
    read_points,
    read_shape,
    shape_file,
    welded,
)
from so101_motion.planning.differential.guard import Guard
from so101_motion.planning.differential.servo import Servo
from so101_motion.planning.differential.targets import Twist
from so101_motion.planning.goals import JointGoal, LeaveContactGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner, PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

HERE = SE3.from_translation((0.3, 0.0, 0.1))
CORNERS = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])


def obstacle(name="mug", shape=None, pose=HERE, **settings):
    shape = shape or Sphere(radius=0.04)
    return Obstacle(name=name, shape=shape, T_base_obstacle=pose, **settings)


def touching(*names):
    return Scene(may_touch=frozenset({frozenset(names)}))


def held(name="pen", **settings):
    return Attached(
        name=name, shape=Capsule(radius=0.005, length=0.14), T_tool_object=HERE, **settings
    )


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Box(size=(0.1, -0.1, 0.1)), '"size" = .* must be 0 or more and at most 100 m'),
        (lambda: Box(size=(0.1, 0.1)), "must be 3 lengths in metres; these are 2"),
        (lambda: Box(size="big"), "must be 3 lengths in metres"),
        (lambda: Sphere(radius=float("inf")), '"radius" = inf: .* at most 100 m'),
        (lambda: Sphere(radius="wide"), "must be a length in metres"),
        (lambda: Sphere(radius=250.0), '"radius" = 250.0: must be 0 or more and at most 100 m'),
        (lambda: Capsule(radius=0.05, length=0.09), '"length" = .* at least 0.1 m from tip to tip'),
        (lambda: Capsule(radius=0.0, length=0.09), '"radius" = 0.0: must be more than 0'),
        (lambda: Mesh(vertices=[], triangles=[[0, 1, 2]]), '"vertices"'),
        (lambda: Mesh(vertices=CORNERS, triangles=[]), r'"triangles" = .* shape \(m, 3\), m >= 1'),
        (lambda: Mesh(vertices=CORNERS, triangles=[[0, 1, 4]]), '"triangles" = 4: is not a vertex'),
        (lambda: Mesh(vertices=CORNERS * np.nan, triangles=[[0, 1, 2]]), '"vertices" = .* finite'),
        (lambda: PointCloud(points=np.empty((0, 3))), '"points" = .* at least one finite point'),
        (lambda: PointCloud(points=CORNERS, resolution=0.0), '"resolution" = 0.0: must be more'),
        (lambda: PointCloud(points=CORNERS, resolution=1e-6), "too fine .* make it 3.1e-06 m or"),
        (lambda: obstacle(name=""), "each obstacle needs a name"),
        (lambda: Obstacle(name="a", shape=Sphere(radius=0.1), T_base_obstacle=(0, 0, 1)), "an SE3"),
        (lambda: obstacle(pose=-np.eye(4)), '"T_base_obstacle of mug" .* orthonormal'),
        (lambda: obstacle(shape="box"), '"shape of mug" = .box.: must be a shape, such as Box'),
        (lambda: obstacle(mass="heavy"), '"mass of mug" = .heavy.: must be a number'),
        (lambda: Scene(obstacles=obstacle()), "must be a tuple of Obstacle"),
        (lambda: obstacle(pose=SE3(np.eye(3), (300, 0, 0))), "of mug.* mean millimetres"),
        (lambda: obstacle(pose=SE3.from_translation((np.nan, 0, 0))), "of mug.* finite numbers"),
        (lambda: held(mass=-1.0), '"mass of pen" = -1.0: .* of at least 0 kg'),
        (lambda: Scene(margin=0.0), '"margin" = 0.0: .* of more than 0 and at most 0.1 m'),
        (lambda: Scene(floor_z=float("nan")), '"floor_z" = nan: must be a finite number'),
        (lambda: Scene(obstacles=(obstacle(), obstacle())), "'mug': is there twice"),
        (lambda: Scene(obstacles=(obstacle("pen"),), attached=(held(),)), "'pen': is there twice"),
        (lambda: Scene(obstacles=(obstacle("wrist"),)), "'wrist': is there twice, as part of the"),
        (lambda: touching("gripper", "mog"), "'mog': is not in this scene; there are base, floor"),
        (lambda: Scene(attached=(held(may_touch=frozenset({"flor"})),)), "'flor': .*, pen, "),
        (lambda: touching("floor"), "must be the names of two things"),
    ],
)
def test_invalid_input_is_refused_in_a_sentence(make, says):
    with pytest.raises(ConfigError, match=says):
        make()


CLOUD = PointCloud(points=CORNERS, resolution=0.02)
MESH = Mesh(vertices=CORNERS, triangles=[[0, 1, 2], [0, 1, 3]])
OTHER_ARM = StandingArm(name="right", T_base_arm=HERE, q=np.zeros((1, 6)))


@pytest.mark.parametrize(
    "other",
    [
        Scene(obstacles=(obstacle("cup"),)),
        Scene(obstacles=(obstacle(shape=Sphere(radius=0.041)),)),
        Scene(obstacles=(obstacle(shape=Box(size=(0.04, 0.04, 0.04))),)),
        Scene(obstacles=(obstacle(shape=CLOUD),)),
        Scene(obstacles=(obstacle(shape=MESH),)),
        Scene(obstacles=(obstacle(pose=SE3.from_rpy((0.1, 0, 0), HERE.p)),)),
        Scene(obstacles=(obstacle(keep_out=True),)),
        Scene(obstacles=(obstacle(),), margin=0.004),
        Scene(obstacles=(obstacle(),), floor_z=None),
        Scene(obstacles=(obstacle(),), may_touch=frozenset({frozenset({"mug", "jaw"})})),
        Scene(obstacles=(obstacle(),), attached=(held(),)),
        Scene(obstacles=(obstacle(),), arms=(OTHER_ARM,)),
    ],
)
def test_scenes_are_equal_if_and_only_if_all_in_them_is(other):
    scene = Scene(obstacles=(obstacle(),))
    assert scene == Scene(obstacles=(obstacle(),))
    assert hash(scene) == hash(Scene(obstacles=(obstacle(),)))
    assert scene != other
    assert other != Scene(attached=(held(mass=0.1),))


# Meshes and clouds are as solid as a box, and what they do not enclose has no depth


SIZE = np.array([0.12, 0.16, 0.1])
MODEL = RobotModel.load()
LIMITS = MotionLimits.uniform(velocity=1.0, acceleration=4.0, jerk=60.0)


def mesh(surface):
    return Mesh(vertices=np.array(surface.vertices), triangles=np.array(surface.faces))


def scene(shape, p, R=None):
    R = np.eye(3) if R is None else R
    return Scene(
        obstacles=(Obstacle(name="block", shape=shape, T_base_obstacle=SE3(R, p)),), floor_z=None
    )


def forms_of_a_block():
    coarse = trimesh.creation.box(extents=SIZE)
    fine = coarse
    for _ in range(5):
        fine = fine.subdivide()
    axes = [(np.arange(round(size / 0.01)) + 0.5) * 0.01 - size / 2 for size in SIZE]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    shell = (np.abs(np.abs(grid) - (SIZE / 2 - 0.005)) < 1e-6).any(axis=1)
    return [mesh(coarse), mesh(fine), PointCloud(points=grid[shell])]


@pytest.mark.parametrize("compiled", [True, False])
def test_a_block_is_the_same_block_in_every_form(compiled):
    random, forms = np.random.default_rng(1), forms_of_a_block()
    for _ in range(4):
        q = random.uniform(MODEL.lower, MODEL.upper)
        p = MODEL.frame(q).p + random.uniform(-0.12, 0.12, 3)
        R = np.linalg.qr(random.standard_normal((3, 3)))[0]
        R *= np.linalg.det(R)
        box = (CollisionModel if compiled else CoalJudge)(MODEL, scene(Box(size=SIZE), p, R))
        for form in forms:
            other = (CollisionModel if compiled else CoalJudge)(MODEL, scene(form, p, R))
            assert other.is_free(q) == box.is_free(q)
            assert other.clearance(q).distance == pytest.approx(box.clearance(q).distance, abs=1e-3)


@pytest.mark.parametrize("sides", ["all", "front", "pocket"])
def test_what_the_arm_is_deep_in_can_be_left(sides):
    block = trimesh.creation.box(extents=(0.2, 0.3, 0.3))
    if sides == "front":
        block.update_faces(block.face_normals[:, 0] < -0.9)
    elif sides == "pocket":
        hole = trimesh.creation.box(extents=(0.1, 0.1, 0.1))
        block = block.difference(hole.apply_translation((0.1, 0.0, 0.0)))
    around = scene(mesh(block), MODEL.frame(np.zeros(5)).p + np.array([0.12, 0, 0]))
    collision = CollisionModel(MODEL, around)
    closest = collision.clearance(np.zeros(5))
    assert not collision.is_free(np.zeros(5))
    assert ("in contact with" in closest.message()) == (sides == "front")
    limits = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=50.0)
    request = PlanRequest(q_start=np.zeros(5), goal=LeaveContactGoal(), limits=limits, scene=around)
    plan = Planner(MODEL).plan(request)
    assert collision.is_free(plan.q_goal)
    assert plan.report.blind == (sides == "front")
    if sides == "front":
        with pytest.raises(InCollision, match="'block': how deep is not known, so guide it out by"):
            Planner(MODEL).plan(
                replace(request, goal=JointGoal(q=np.array([1.5, -1.0, 0.5, 0.5, 0.0])))
            )


def test_the_room_the_arm_stands_in_is_not_solid():
    room = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    assert CollisionModel(MODEL, scene(mesh(room), np.zeros(3))).is_free(np.zeros(5))


@pytest.mark.parametrize("shape", [Box(size=(0.0, 0.2, 0.2)), Sphere(radius=0.0)])
def test_plates_and_points_keep_their_margin(shape):
    tip = MODEL.frame(np.zeros(5)).p
    for compiled in (True, False):
        for beyond, free in ((0.0, False), (0.25, True)):
            around = scene(shape, tip + np.array([beyond, 0, 0]))
            collision = (CollisionModel if compiled else CoalJudge)(MODEL, around)
            assert collision.is_free(np.zeros(5)) == free


def front_of_a_block(form):
    """What a camera in front sees of a block 30 mm of whose front the gripper is in."""
    block = trimesh.creation.box(extents=(0.2, 0.3, 0.3))
    block.update_faces(block.face_normals[:, 0] < -0.9)
    if form == "cloud":
        shape = PointCloud(points=trimesh.sample.sample_surface(block, 9000, seed=1)[0])
    else:
        shape = mesh(block)
    return scene(shape, MODEL.frame(np.zeros(5)).p + np.array([0.07, 0, 0]))


@pytest.mark.parametrize("form", ["mesh", "cloud"])
def test_an_arm_in_a_surface_is_not_moved_by_jogs_followings_or_streams(form):
    collision, q = CollisionModel(MODEL, front_of_a_block(form)), np.zeros(5)
    servo = Servo(MODEL, collision, LIMITS, 0.01, q)
    for direction in np.vstack((np.eye(3), -np.eye(3))):
        for _ in range(20):
            servo.step(Twist(linear=0.1 * direction, angular=np.zeros(3)))
        np.testing.assert_array_equal(servo.q, q)
    assert "in contact with 'block': how deep is not known" in servo.held_by()[0]
    guard = Guard(collision, lambda: 0.0, acceleration=np.full(5, 10.5))
    assert guard.within_reach(q, q + 0.1) is q
    assert guard.against == servo.held_by()
    out = np.linspace(q, q - 0.002, 5)
    assert not guard.admits(out)
    assert guard.contact(out)[1] == "'block'"
    assert guard.contact(np.zeros((5, 5))) is None, "it may stay"
    assert guard.guided_to(q, q + 0.02) == pytest.approx(q + 0.02), "a hand may lead it"


def test_a_fine_ball_in_the_hand_is_a_ball():
    fine = mesh(trimesh.creation.icosphere(subdivisions=4, radius=0.03))
    at = SE3(np.eye(3), np.array([0.0, 0.0, 0.05]))
    fine, ball = (
        CollisionModel(MODEL, Scene(attached=(Attached(name="b", shape=e, T_tool_object=at),)))
        for e in (fine, Sphere(radius=0.03))
    )
    random = np.random.default_rng(0)
    for q in random.uniform(MODEL.lower, MODEL.upper, (20, 5)):
        off = ball.distances(q) - fine.distances(q)
        assert np.abs(off).max() < 5e-4, "it stands out by 0.3 mm at most"


def test_more_things_than_fit_a_mask_are_refused():
    things = tuple(
        Attached(name=f"{k}", shape=Sphere(radius=0.01), T_tool_object=SE3.identity())
        for k in range(25)
    )
    with pytest.raises(ConfigError, match="24 can be held"):
        Scene(attached=things)


# Files of meshes and point clouds: read as they are, or refused after their headers


TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype="<f4") / 10
FACES = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]])


def stl(corners):
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    surface = trimesh.Trimesh(corners.reshape(-1, 3), faces, process=False)
    return b"solid but binary".ljust(80) + surface.export(file_type="stl")[80:]


def ply(corners, faces):
    return trimesh.Trimesh(corners, faces, process=False).export(file_type="ply")


def with_carriage_returns(data):
    head, end, body = data.partition(b"end_header\n")
    return (head + end).replace(b"\n", b"\r\n") + body


def pcd(count, data=b"binary", body=b""):
    return (
        b"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\n"
        b"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS %s\nDATA %s\n" % (count, data)
    ) + body


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        ("stl", stl(TETRAHEDRON[FACES])),
        ("ply", ply(TETRAHEDRON, FACES)),
        ("ply", with_carriage_returns(ply(TETRAHEDRON, FACES))),
    ],
    ids=["stl", "ply", "ply with carriage returns"],
)
def test_binary_meshes_are_read_without_trimesh(kind, data, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    assert mesh_kind(data) == kind
    vertices, triangles = welded(*read_mesh(kind, data))
    assert len(vertices) == 4
    found = {tuple(sorted(map(tuple, np.round(vertices[t], 6)))) for t in triangles}
    assert found == {
        tuple(sorted(map(tuple, np.round(TETRAHEDRON[t].astype(float), 6)))) for t in FACES
    }


@pytest.mark.parametrize(
    ("kind", "data", "says"),
    [
        ("stl", stl(np.zeros((MOST_TRIANGLES + 1, 3, 3))), "triangles"),
        ("ply", ply(TETRAHEDRON, FACES).replace(b"face 4", b"face 1000000"), "1000000 triangles"),
        ("ply", ply(TETRAHEDRON, FACES).replace(b"vertex 4", b"vertex %d" % 10**30), "vertices"),
        ("ply", b"ply\n" + b"a" * 100_000, "head"),
        ("pcd", pcd(b"%d" % (MOST_POINTS + 1)), "points"),
        ("pcd", pcd(b"1" + b"0" * 30), "points"),
        ("pcd", pcd(b"1e30"), "not a number of points"),
        ("pcd", pcd(b"-1"), "not a number of points"),
        ("stl", b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        ("pcd", pcd("٣".encode()), "PCD"),
        ("pcd", b"x" * 100_000, "DATA"),
    ],
    ids=range(11),
)
def test_too_much_is_refused_from_the_head_alone(kind, data, says):
    begin = time.thread_time()
    with pytest.raises(ConfigError, match=says):
        shape_file(kind, data, name="part")
    assert time.thread_time() - begin < 1.0


@pytest.mark.parametrize(
    "data",
    [
        pcd(b"2", body=b"\0" * 12),
        pcd(b"1", body=b"\1" * 24),
        pcd(b"1", b"ascii", b"1 2 3 4 5 6"),
        pcd(b"1", b"binary_compressed", struct.pack("<II", 2, 12) + b"\0\0"),
        pcd(b"1", b"ascii", b"1 2"),
        pcd(b"1", b"ascii", b"1 2 x"),
        pcd(b"1", b"binary_compressed"),
        pcd(b"1").replace(b"SIZE 4", b"SIZE -4"),
        pcd(b"1").replace(b"COUNT 1", b"COUNT 99999999999"),
        pcd(b"1").replace(b"COUNT 1", b"COUNT 0"),
        pcd(b"1").replace(b"FIELDS x", b"FIELDS w"),
        pcd(b"1").replace(b"TYPE F F F", b"TYPE F"),
    ],
)
def test_a_cloud_that_is_none_is_refused(data):
    with pytest.raises(ConfigError, match="PCD"):
        read_points(data)


@pytest.mark.parametrize("far", [1e308, 1e30, np.inf, np.nan])
def test_invalid_coordinates_are_refused_with_the_name(far):
    corners = TETRAHEDRON.astype("<f8")
    corners[2, 1] = far
    rows = [b"%r %r %r\n" % tuple(map(float, row)) for row in corners]
    cloud = shape_file("pcd", pcd(b"4", b"ascii", b"".join(rows)), name="seen")
    mesh = b"v " + b"v ".join(rows) + b"f 1 2 3\nf 1 2 4\n"
    for file in (cloud, shape_file("obj", mesh, name="seen")):
        with pytest.raises(ConfigError, match=r"\(of seen\)"):
            read_shape(file)


def test_a_coarse_mesh_joins_the_vertices_of_a_cell_and_drops_what_collapses():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.01, 0, 0]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 3, 2]], dtype=np.int32)
    vertices, faces = coarse([(vertices, faces)], 0.1)

    assert len(vertices) == 3
    assert len(faces) == 1
    assert sorted(vertices[:, 0]) == pytest.approx([0.0, 0.005, 1.0])


POINTS = np.array([[0.1, 0.2, 0.3], [-1.0, 0.0, 2.5], [0.0, 0.25, 0.0]])


def ply_of_points(form: str) -> bytes:
    head = (
        f"ply\nformat {form} 1.0\ncomment seen\nelement vertex 3\nproperty float x\n"
        "property float y\nproperty float z\nproperty uchar red\nend_header\n"
    ).encode()
    if form == "ascii":
        return head + b"".join(b"%g %g %g 7\n" % tuple(p) for p in POINTS)
    order = "<" if "little" in form else ">"
    record = np.dtype([("p", f"{order}f4", 3), ("red", "u1")])
    rows = np.zeros(3, record)
    rows["p"] = POINTS
    return head + rows.tobytes()


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_ply_file_without_faces_is_a_cloud(form):
    assert not holds_faces(ply_of_points(form))
    np.testing.assert_allclose(read_cloud("ply", ply_of_points(form)), POINTS, 1e-6)


@pytest.mark.parametrize(
    "text",
    [
        b"0.1 0.2 0.3\n-1 0 2.5\n0 0.25 0\n",
        b"# made by hand\n//X Y Z\nx,y,z\n3\n0.1,0.2,0.3,255\r\n-1,0,2.5,9\n\n0,0.25,0,1",
        b"0.1 0.2 0.3\nnan nan nan\n-1 0 2.5\n0 0.25 0",
    ],
)
def test_a_text_of_points_is_read_whatever_is_around_them(text):
    np.testing.assert_allclose(read_cloud("xyz", text), POINTS)


@pytest.mark.parametrize(
    ("kind", "data"),
    [("xyz", b""), ("xyz", b"1 2 three\n"), ("xyz", b"1 2\n"), ("ply", b"ply\n"),
     ("ply", ply_of_points("binary_little_endian")[:-1]), ("pcd", b"1 2 3"),
     ("ply", ply_of_points("ascii").replace(b"property float z\n", b""))],
)  # fmt: skip
def test_a_file_without_points_is_refused(kind, data):
    with pytest.raises(ConfigError):
        read_cloud(kind, data)


L = np.array([[0, 0], [40, 0], [40, 10], [10, 10], [10, 30], [0, 30]], float)
PRISM = np.vstack([np.c_[L, np.zeros(6)], np.c_[L, np.full(6, 20.0)]])
POLYGONS = [[1, 0, 5, 4, 3, 2], [7, 8, 9, 10, 11, 6]]
POLYGONS += [[i, (i + 1) % 6, 6 + (i + 1) % 6, 6 + i] for i in range(6)]


def obj_text(parts=1, *, relative=False):
    lines = []
    for part in range(parts):
        lines += [f"o part{part}", *(f"v {x + 100 * part} {y} {z}" for x, y, z in PRISM)]
        for face in POLYGONS:
            corners = (i - 12 if relative else i + 1 + 12 * part for i in face)
            lines.append("f " + " ".join(f"{i}/1" for i in corners))
    return "\n".join(lines).encode()


def polygons_ply(order):
    head = f"ply\nformat binary_{order}_endian 1.0\nelement vertex 12\n" + "".join(
        f"property float {axis}\n" for axis in "xyz"
    )
    head += "element face 8\nproperty list uchar int vertex_index\nend_header\n"
    sign = "<" if order == "little" else ">"
    faces = b"".join(struct.pack(f"{sign}B{len(f)}i", len(f), *f) for f in POLYGONS)
    return head.encode() + PRISM.astype(f"{sign}f4").tobytes() + faces


def text_stl(name):
    surface = trimesh.Trimesh(*read_mesh("obj", obj_text()), process=False)
    _, _, facets = surface.export(file_type="stl_ascii").partition("\n")
    return f"solid {name}\n{facets}\n".encode()


def text_ply():
    surface = trimesh.Trimesh(*read_mesh("obj", obj_text()), process=False)
    return surface.export(file_type="ply", encoding="ascii")


@pytest.mark.parametrize(
    ("kind", "data", "parts"),
    [
        ("obj", obj_text(), 1),
        ("obj", obj_text(2, relative=True), 2),
        ("ply", polygons_ply("little"), 1),
        ("ply", polygons_ply("big"), 1),
        ("ply", text_ply(), 1),
        ("stl", text_stl("my facet, endfacet, vertex group"), 1),
        ("stl", text_stl("a") + text_stl("b").replace(b"vertex 4", b"vertex 14"), None),
    ],
)
def test_a_part_with_a_notch_has_its_volume_and_surface(kind, data, parts):
    vertices, triangles = read_mesh(kind, data)
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    if parts is None:
        assert len(triangles) == 40
        return
    assert abs(np.sum(a * np.cross(b, c)) / 6.0) == pytest.approx(12_000.0 * parts)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0
    assert area == pytest.approx(4_000.0 * parts), "a fan would cover the notch"
    assert np.ptp(vertices, axis=0)[0] == 40.0 + 100.0 * (parts - 1)


def test_bytes_after_a_binary_stl_are_left_and_missing_ones_are_named():
    data = stl(TETRAHEDRON[FACES])
    assert len(read_mesh("stl", data + b"\0\0more")[1]) == 4
    with pytest.raises(ConfigError, match="triangles"):
        read_mesh("stl", b"solid x\n" + b"endfacet\n" * (MOST_TRIANGLES + 1))
    with pytest.raises(ConfigError, match="cut off"):
        read_mesh("stl", data[:-3])
    with pytest.raises(ConfigError, match="end-of-file"):
        read_mesh("ply", polygons_ply("little")[:-3])


def test_a_compressed_cloud_is_read():
    # x of both points, then y, then z; the last item copies the four bytes of y's second number
    plain = np.array([1, 2, 3, 4, 5, 4], "<f4").tobytes()
    packed = b"\x13" + plain[:20] + bytes([2 << 5, 7])
    body = struct.pack("<II", len(packed), 24) + packed
    cloud = read_points(pcd(b"2", b"binary_compressed", body))
    np.testing.assert_array_equal(cloud, [[1, 3, 5], [2, 4, 4]])


@pytest.mark.parametrize("generator", ["trimesh", "Open CASCADE Technology 8.0 [x]"])
def test_a_glb_is_in_metres_with_y_up_and_a_part_of_open_cascade_in_its_place(generator):
    turn = trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0))
    placed = turn.copy()
    placed[:3, 3] = (0.24, 0.0, 0.13) if "CASCADE" in generator else (0.24, 0.13, 0.0)
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box((0.02, 0.12, 0.26)), transform=placed)

    def named(tree):
        tree["asset"]["generator"] = generator
        for node in tree["nodes"]:
            if node.pop("matrix", None):
                node["rotation"] = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
                node["translation"] = placed[:3, 3].tolist()

    data = scene.export(file_type="glb", tree_postprocessor=named)
    vertices = file_mesh("glb", data).vertices
    np.testing.assert_allclose(vertices.min(axis=0), [0.23, -0.06, 0.0], atol=1e-6)
    np.testing.assert_allclose(vertices.max(axis=0), [0.25, 0.06, 0.26], atol=1e-6)


def test_a_face_with_a_vertex_that_is_not_there_is_refused():
    triangle = trimesh.Trimesh(np.eye(3), [[0, 1, 2]], process=False)
    good, bad = (np.array(each, "<u4").tobytes() for each in ([0, 1, 2], [0, 1, 9]))
    file = triangle.export(file_type="glb")
    assert len(file_mesh("glb", file).triangles) == 1
    with pytest.raises(ConfigError, match="beyond the 3"):
        file_mesh("glb", file.replace(good, bad))


def test_3mf_without_networkx_says_what_to_export(monkeypatch):
    monkeypatch.setattr(trimesh, "available_formats", lambda: {"glb"})
    with pytest.raises(ConfigError, match="export STL or GLB"):
        file_mesh("3mf", b"PK")


@pytest.mark.parametrize(
    ("kind", "data", "says"),
    [
        ("gltf", b'{"asset": {"version": "2.0"}, "buffers": [{"uri": "p.bin"}]}', "export GLB"),
        ("ply", b"ply\nformat ascii 1.0\nelement tristrips 0\nproperty list uchar int "
                b"vertex_indices\nend_header\n", "holds no faces; export triangles"),
    ],
)  # fmt: skip
def test_what_is_elsewhere_or_no_face_is_refused_with_what_to_export(kind, data, says):
    with pytest.raises(ConfigError, match=says):
        file_mesh(kind, data)


def test_an_item_is_an_obstacle_until_it_is_held_and_where_it_is_put_afterwards():
    cube = Obstacle(
        name="cube",
        shape=Box(size=(0.02, 0.02, 0.02)),
        T_base_obstacle=SE3.from_rpy((0.0, 0.0, 0.4), (0.2, 0.1, 0.0076)),
        mass=0.03,
    )
    mug = Obstacle(name="mug", shape=Sphere(radius=0.03), T_base_obstacle=SE3.identity())
    scene = Scene(obstacles=(cube, mug))
    assert scene.items == (cube,)
    tool = SE3.from_rpy((3.0, 0.1, 0.0), (0.2, 0.1, 0.02))
    taken = scene.taking("cube", tool)
    assert taken.obstacles == (mug,)
    (held,) = taken.attached
    assert held.mass == 0.03
    put = taken.putting("cube", tool @ held.T_tool_object)
    np.testing.assert_allclose(
        put.items[0].T_base_obstacle.matrix, cube.T_base_obstacle.matrix, atol=1e-12
    )
    assert put.items[0].mass == 0.03
    assert put.digest != scene.digest  # the order differs
    with pytest.raises(ConfigError, match='did you mean "cube"'):
        scene.taking("cubes", tool)
    with pytest.raises(ConfigError, match="empty space"):
        replace(cube, keep_out=True)
