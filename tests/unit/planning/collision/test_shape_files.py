"""Files of meshes and point clouds: read as they are, or refused after their headers."""

import io
import struct
import sys
import time
import zipfile

import numpy as np
import pytest
import trimesh

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Obstacle, Scene, ShapeFile
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


def test_other_forms_of_meshes_are_read():
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


def test_too_many_triangles_as_text_are_refused_when_they_are_read():
    with pytest.raises(ConfigError, match="triangles"):
        read_mesh("stl", b"solid x\n" + b"endfacet\n" * (MOST_TRIANGLES + 1))


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
    vertices, triangles = read_mesh("obj", obj_text())
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join("vertex {} {} {}\n".format(*vertices[i]) for i in triangle)
        + "endloop\nendfacet\n"
        for triangle in triangles
    )
    return f"solid {name}\n{facets}endsolid {name}\n".encode()


@pytest.mark.parametrize(
    ("kind", "data", "parts"),
    [
        ("obj", obj_text(), 1),
        ("obj", obj_text(2, relative=True), 2),
        ("ply", polygons_ply("little"), 1),
        ("ply", polygons_ply("big"), 1),
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
    data = stl(CORNERS[FACES])
    assert len(read_mesh("stl", data + b"\0\0more")[1]) == 4
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
    import trimesh

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
    with pytest.raises(ConfigError, match="none of the 3"):
        file_mesh("glb", file.replace(good, bad))


def inches():
    model = """<model unit="inch" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">
    <resources><object id="1" type="model"><mesh><vertices><vertex x="0" y="0" z="0"/>
    <vertex x="2" y="0" z="0"/><vertex x="0" y="1" z="0"/></vertices><triangles>
    <triangle v1="0" v2="1" v3="2"/></triangles></mesh></object></resources>
    <build><item objectid="1"/></build></model>"""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as opened:
        opened.writestr("3D/3dmodel.model", model)
    return file.getvalue()


def test_3mf_is_read_in_its_unit_where_networkx_and_lxml_are_installed():
    pytest.importorskip("networkx")
    pytest.importorskip("lxml")
    assert file_mesh("3mf", inches()).vertices.max(axis=0) == pytest.approx([0.0508, 0.0254, 0.0])


def test_3mf_without_networkx_says_what_to_export(monkeypatch):
    monkeypatch.setattr(trimesh, "available_formats", lambda: {"glb"})
    with pytest.raises(ConfigError, match="export STL or GLB"):
        file_mesh("3mf", inches())


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
