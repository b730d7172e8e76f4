"""Files of meshes and point clouds: read as they are, or refused after their headers."""

import struct
import sys
import time

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Obstacle, Scene, ShapeFile
from so101_motion.planning.collision.shape_files import (
    MOST_POINTS,
    MOST_TRIANGLES,
    coarse,
    holds_faces,
    mesh_kind,
    read_cloud,
    read_mesh,
    read_points,
    read_shape,
    shape_file,
    welded,
)

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype="<f4") / 10
FACES = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]])
STL_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def stl(corners):
    records = np.zeros(len(corners), STL_RECORD)
    records["corners"] = corners
    return b"solid but binary".ljust(80) + struct.pack("<I", len(corners)) + records.tobytes()


def ply(corners, faces, *, extra=b"", ends=b"\n"):
    head = (
        b"ply\nformat binary_little_endian 1.0\ncomment a tetrahedron\n"
        b"element vertex %d\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face %d\nproperty list uchar int vertex_indices\nend_header\n"
    ) % (len(corners), len(faces))
    records = np.zeros(len(faces), np.dtype([("n", "u1"), ("corners", "<i4", 3)]))
    records["n"], records["corners"] = 3, faces
    return head.replace(b"\n", ends) + corners.tobytes() + records.tobytes() + extra


def pcd(count, data=b"binary", body=b""):
    return (
        b"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\n"
        b"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS %s\nDATA %s\n" % (count, data)
    ) + body


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        ("stl", stl(CORNERS[FACES])),
        ("ply", ply(CORNERS, FACES)),
        ("ply", ply(CORNERS, FACES, ends=b"\r\n")),
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
        tuple(sorted(map(tuple, np.round(CORNERS[t].astype(float), 6)))) for t in FACES
    }


def test_other_forms_of_meshes_are_read_by_trimesh():
    import trimesh

    body = trimesh.Trimesh(CORNERS, FACES, process=False)
    for kind, form in (("stl", "stl_ascii"), ("ply", "ply")):
        data = body.export(file_type=form, **({"encoding": "ascii"} if kind == "ply" else {}))
        data = data.encode() if isinstance(data, str) else data
        assert mesh_kind(data) == kind
        assert len(read_mesh(kind, data)[1]) == 4


@pytest.mark.parametrize(
    ("kind", "data", "says"),
    [
        ("stl", stl(np.zeros((MOST_TRIANGLES + 1, 3, 3))), "triangles"),
        ("ply", ply(CORNERS, FACES).replace(b"face 4", b"face 1000000"), "1000000 triangles"),
        ("ply", ply(CORNERS, FACES).replace(b"vertex 4", b"vertex %d" % 10**30), "vertices"),
        ("ply", b"ply\n" + b"a" * 100_000, "head"),
        ("pcd", pcd(b"%d" % (MOST_POINTS + 1)), "points"),
        ("pcd", pcd(b"1" + b"0" * 30), "points"),
        ("pcd", pcd(b"1e30"), "not a number of points"),
        ("pcd", pcd(b"-1"), "not a number of points"),
        ("pcd", pcd("٣".encode()), "PCD"),
        ("pcd", b"x" * 100_000, "DATA"),
    ],
    ids=range(10),
)
def test_too_much_is_refused_from_the_head_alone(kind, data, says):
    begin = time.thread_time()
    with pytest.raises(ConfigError, match=says):
        shape_file(kind, data, name="part")
    assert time.thread_time() - begin < 0.1


def test_too_many_triangles_as_text_are_refused_when_they_are_read():
    with pytest.raises(ConfigError, match="triangles"):
        read_mesh("stl", b"solid x\n" + b"endfacet\n" * (MOST_TRIANGLES + 1))


@pytest.mark.parametrize(
    "data",
    [
        pcd(b"2", body=b"\0" * 12),
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
    corners = CORNERS.astype("<f8")
    corners[2, 1] = far
    text = b"".join(b"%r %r %r\n" % tuple(map(float, row)) for row in corners)
    cloud = shape_file("pcd", pcd(b"4", b"ascii", text), name="seen")
    mesh = ply(corners, FACES).replace(b"float", b"double")
    for file in (cloud, shape_file("ply", mesh, name="seen")):
        with pytest.raises(ConfigError, match=r"\(of seen\)"):
            read_shape(file)


def test_a_file_is_the_same_scene_again_and_another_one_is_not():
    def scene(data):
        file = ShapeFile(kind="stl", data=np.frombuffer(data, np.uint8), name="part")
        return Scene(obstacles=(Obstacle(name="part", shape=file, T_base_obstacle=SE3.identity()),))

    assert scene(stl(CORNERS[FACES])) == scene(stl(CORNERS[FACES]))
    assert scene(stl(CORNERS[FACES])) != scene(stl(2 * CORNERS[FACES]))


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
