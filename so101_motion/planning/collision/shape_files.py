"""Read meshes (STL, PLY, OBJ, GLB, 3MF) and point clouds (PCD, PLY, XYZ), and simplify meshes.

A file of a million triangles takes a second to read. So a request handler reads only its head
(``shape_file``) and passes its bytes on; the planning process reads the rest (``read_shape``). The
head says how large the content is, and too much is refused before anything is read.

Each format is read by what read it rightly when genuine files of ten programs were tried: PLY by
plyfile, polygons are cut by mapbox_earcut, GLB and 3MF are read by trimesh. trimesh 5.2 places
objects of an OBJ file with relative indices on each other, draws polygons over their notches, and
reads an STL file with further bytes, or with "vertex" in its name, as empty; assimp, which coal
brings, reads all of them, but a PLY file that was cut off ends the process. So STL and OBJ are
read here, in a few lines each.
"""

from __future__ import annotations

import io
import json
import re
import struct
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import mapbox_earcut
import numpy as np
import plyfile

from so101_motion.common import git_lfs
from so101_motion.common.errors import ConfigError, clipped
from so101_motion.common.geometry import Array
from so101_motion.planning.collision.scene import (
    Mesh,
    PointCloud,
    Shape,
    ShapeFile,
    refuse_odd_size,
)

MESHES = ("stl", "ply", "obj", "off", "glb", "gltf", "3mf")
"""Endings of the mesh files that are read."""

MOST_TRIANGLES = 300_000  # of a mesh; chosen: its tree takes half a second
MOST_POINTS = 1_000_000  # of a cloud or a mesh; chosen, a depth camera of 1280x720
LARGEST_FILE = 32 << 20  # largest file that is read [byte]: the largest message of viam-server

SAME_POINT = 1e-6
"""Largest distance at which a centre counts as the middle of a cloud's points [m], and the same as
a share of the largest coordinate: viam-server computes it from floats of 32 bits."""

_HEAD = 65_536  # longest head of a file [byte]. Chosen; heads have some hundred


def shape_file(
    kind: str, data: bytes | memoryview, *, name: str, centre: Array | None = None
) -> ShapeFile:
    """Check the head of a mesh or cloud in metres, and wrap its bytes for the planner."""
    _refuse_large(kind, bytes(data[:_HEAD]), len(data))
    return ShapeFile(kind=kind, data=np.frombuffer(data, np.uint8), name=name, centre=centre)


def read_shape(shape: Shape | ShapeFile) -> Shape:
    """Read the shape in a file; returns any other shape as it is."""
    if not isinstance(shape, ShapeFile):
        return shape
    data = shape.data.tobytes()
    try:
        read: Shape
        if shape.kind == "pcd":
            read = PointCloud(points=_around(read_points(data), shape.centre))
        else:
            vertices, triangles = read_mesh(shape.kind, data)
            read = Mesh(vertices=vertices, triangles=triangles)
        refuse_odd_size(shape.name, read)
        return read
    except ConfigError as error:
        raise ConfigError(error.key, error.value, f"(of {shape.name}) {error.reason}") from error


def mesh_kind(data: bytes | memoryview) -> str:
    """The kind of a mesh file, by its content: ``"ply"`` or ``"stl"``."""
    head = bytes(data[:_HEAD])
    if head.split(maxsplit=1)[:1] == [b"ply"]:
        return "ply"
    if _is_text_stl(head) or 0 < 50 * _stl_count(head) <= len(data) - 84:
        return "stl"
    raise ConfigError("mesh", f"{len(data)} bytes", "must be a PLY or STL file")


def file_mesh(kind: str, data: bytes, *, scale: float = 1.0, most: int = MOST_TRIANGLES) -> Mesh:
    """Read the mesh in a file of a disk; its unit is what the format declares, or millimetres.

    ``kind`` is the file's ending, one of ``MESHES``; ``scale`` a factor for its lengths, 1000 for a
    file of an undeclared unit in metres; ``most`` the most triangles.
    """
    kind = kind.removeprefix(".")
    vertices, triangles = read_mesh(kind, data, most=most)
    if kind not in ("glb", "gltf", "3mf"):  # these are in metres when they were read
        vertices = vertices / 1000.0
    vertices, triangles = welded(vertices, triangles)
    return Mesh(vertices=scale * vertices, triangles=triangles)


def read_mesh(kind: str, data: bytes, *, most: int = MOST_TRIANGLES) -> tuple[Array, Any]:
    """Read vertices (n, 3) and triangles (m, 3), at most ``most``.

    Lengths are metres and z is up where the format declares them (GLB, 3MF); else as in the file.
    """
    if not isinstance(data, bytes | bytearray):
        raise ConfigError("mesh", data, "is not bytes; give the bytes: Path(...).read_bytes()")
    size = f"{len(data)} bytes"
    if kind not in MESHES:
        reason = f"is not one of {', '.join(MESHES)}; export STL or GLB"
        raise ConfigError("mesh", f".{kind}", reason)
    _refuse_large(kind, data, len(data), most)
    readers = {"stl": _stl, "ply": _ply, "obj": _obj}
    try:
        found = readers[kind](data) if kind in readers else _by_trimesh(kind, data)
    except Exception as error:  # the libraries raise whatever they trip over
        reason = f"is not a {kind} file that can be read: {clipped(str(error), 200)}"
        raise ConfigError("mesh", size, reason) from error
    if len(found[1]) == 0:
        raise ConfigError("mesh", size, "holds no triangles; is it a mesh?")
    _refuse_many("mesh", len(data), {"triangles": (len(found[1]), most)})
    return found


def welded(vertices: Array, triangles: Any) -> tuple[Array, Any]:
    """Merge equal vertices of a mesh, (n, 3) and (m, 3); STL repeats them for each triangle."""
    order = np.lexsort(vertices.T)  # ten times as fast as np.unique with rows
    is_new = np.ones(len(vertices), dtype=bool)
    is_new[1:] = np.any(np.diff(vertices[order], axis=0) != 0.0, axis=1)
    place = np.empty(len(vertices), dtype=np.intp)
    place[order] = np.cumsum(is_new) - 1
    return vertices[order[is_new]], place[triangles]


def coarse(meshes: Sequence[tuple[Array, Any]], grid: float) -> tuple[Array, Any]:
    """Merge meshes into one with few triangles, for a picture.

    All vertices of a cell of edge ``grid`` [m] become one at their mean; triangles that collapse
    are left out. Of each mesh: vertices (n, 3) [m] in one frame, and triangles (m, 3).
    """
    vertices = np.concatenate([each for each, _ in meshes])
    starts = np.cumsum([0, *(len(each) for each, _ in meshes[:-1])])
    faces = np.concatenate([each + start for (_, each), start in zip(meshes, starts, strict=True)])
    cells = np.round(vertices / grid).astype(np.int64)
    _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    cell = cell.ravel()
    sums = [np.bincount(cell, weights=vertices[:, axis]) for axis in range(3)]
    faces = cell[faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return np.column_stack(sums) / count[:, None], faces[np.sort(first)].astype(np.int32)


def read_points(data: bytes) -> Array:
    """Read the points of a PCD file from Viam's cameras, shape (n, 3), [m]."""
    _refuse_large("pcd", data, len(data))
    try:
        return _pcd(data)
    except (KeyError, ValueError, IndexError, OverflowError) as error:
        raise _no_cloud(data, error) from error


def read_cloud(kind: str, data: bytes) -> Array:
    """Read the points of a PCD, PLY or XYZ file, shape (n, 3), in its unit; n >= 1.

    Points that are not finite, as cameras write them where they see nothing, are left out.
    """
    if len(data) > LARGEST_FILE:
        reason = f"is larger than the {LARGEST_FILE} bytes that are read"
        raise ConfigError("point_cloud", f"{len(data)} bytes", reason)
    if kind == "pcd":
        points = read_points(data)
    elif kind == "ply":
        points = _ply_points(data)
    else:
        points = _text_points(data)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        raise ConfigError("point_cloud", f"{len(data)} bytes", "holds no points")
    return points


def holds_faces(data: bytes) -> bool:
    """Whether a PLY file holds a surface, not only points; ``ConfigError`` if it is no PLY."""
    return _ply_counts(data)["triangles"] > 0


def _refuse_large(kind: str, data: bytes, size: int, most_triangles: int = MOST_TRIANGLES) -> None:
    """Refuse a file of ``size`` bytes with too much content.

    ``data`` is all of it or its head; what has no head is counted when it was read.
    """
    what = "point_cloud" if kind == "pcd" else "mesh"
    if git_lfs.is_pointer(data):
        raise ConfigError(what, f"{size} bytes", f"{git_lfs.POINTER}; {git_lfs.PULL}")
    if size > LARGEST_FILE:
        raise ConfigError(
            what, f"{size} bytes", f"is larger than the {LARGEST_FILE} bytes that are read"
        )
    counts = {}
    if kind == "stl":
        counts = {"triangles": _stl_count(data)}
    elif kind == "ply":
        counts = _ply_counts(data)
    elif kind == "pcd":
        try:
            counts = {"points": _pcd_count(_pcd_head(data)[0])}
        except (KeyError, ValueError, IndexError) as error:
            raise _no_cloud(data, error) from error
    most = {"triangles": most_triangles}
    _refuse_many(what, size, {k: (count, most.get(k, MOST_POINTS)) for k, count in counts.items()})


def _refuse_many(what: str, size: int, counts: dict[str, tuple[int, int]]) -> None:
    for unit, (count, most) in counts.items():
        if count > most:
            raise ConfigError(
                what,
                f"{size} bytes",
                f"has {count:.7g} {unit}, more than the {most} that are read; simplify it or cut it"
                " to the part that the arm can reach",
            )


# Meshes

_CORNER = re.compile(rb"\bvertex" + 3 * rb"\s+([-+.\dEe]+)" + rb"\s", re.IGNORECASE)
_FACET = re.compile(rb"\bouter\s+loop\b", re.IGNORECASE)


def _is_text_stl(data: bytes) -> bool:
    return re.match(rb"\s*solid\b", data, re.IGNORECASE) is not None and b"\0" not in data[:512]


def _stl_count(data: bytes) -> int:
    """Triangles of an STL file: as its head says, or counted in its text."""
    if _is_text_stl(data):
        return len(_FACET.findall(data))
    return int.from_bytes(data[80:84], "little")


def _stl(data: bytes) -> tuple[Array, Any]:
    """Read STL: 80 bytes of any kind, the number of triangles, 50 bytes for each; or text."""
    count = _stl_count(data)
    if _is_text_stl(data):
        numbers = np.array(_CORNER.findall(data), dtype=np.float64).reshape(-1, 3)
        if len(numbers) != 3 * count or (count and b"endsolid" not in data[-200:].lower()):
            reason = f"{count} triangles begin, {len(numbers)} corners are there; was it cut off?"
            raise ValueError(reason)
        return numbers, np.arange(len(numbers)).reshape(-1, 3)
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    held = max(len(data) - 84, 0) // record.itemsize
    if held < count:
        raise ValueError(f"its header says {count} triangles, it has {held}; was it cut off?")
    if len(data) < 84:
        raise ValueError("it is too short")
    corners = np.frombuffer(data, record, count, 84)["corners"]  # some programs append bytes
    return corners.reshape(-1, 3).astype(np.float64), np.arange(3 * count).reshape(-1, 3)


def _ply_counts(data: bytes) -> dict[str, int]:
    head = re.match(rb"ply\s.*?\nend_header\r?\n", data[:_HEAD], re.DOTALL)
    if head is None:
        raise ConfigError("mesh", f"{len(data)} bytes", "is not a ply file: its header has no end")
    found = {b"vertex": 0, b"face": 0, b"tristrips": 0}
    found |= {name: int(n) for name, n in re.findall(rb"\nelement (\w+) (\d{1,18})", head[0])}
    return {"triangles": found[b"face"] + found[b"tristrips"], "vertices": found[b"vertex"]}


def _read_ply(data: bytes) -> plyfile.PlyData:
    """Read a PLY file; fast where all faces are triangles, which only a file of a disk can be."""
    name = b"vertex_indices" if b"vertex_indices" in data[:_HEAD] else b"vertex_index"
    if b"format ascii" not in data[:_HEAD]:
        with tempfile.TemporaryFile() as file, suppress(plyfile.PlyParseError):
            file.write(data)
            file.seek(0)
            return plyfile.PlyData.read(file, known_list_len={"face": {name.decode(): 3}})
    return plyfile.PlyData.read(io.BytesIO(data))


def _ply(data: bytes) -> tuple[Array, Any]:
    file = _read_ply(data)
    if "face" not in file:
        raise ValueError("it holds no faces; export triangles")
    face = file["face"]
    names = [each.name for each in face.properties]
    corners = face[next(name for name in ("vertex_indices", "vertex_index") if name in names)]
    return _triangulated(_axes(file["vertex"]), list(corners))


def _axes(vertex: Any) -> Array:
    return np.stack([np.asarray(vertex[axis], dtype=np.float64) for axis in "xyz"], axis=1)


def _obj(data: bytes) -> tuple[Array, Any]:
    """Read vertices and faces of a Wavefront OBJ; an index below 0 counts from the last vertex."""
    vertices, polygons = [], []
    for line in re.sub(rb"\\\r?\n", b" ", data).splitlines():
        words = line.split()
        if words[:1] == [b"v"]:
            vertices.append(words[1:4])
        elif words[:1] == [b"f"]:
            corners = [int(word.split(b"/")[0]) for word in words[1:]]
            if 0 in corners:
                raise ValueError("a face has the vertex 0; they are counted from 1")
            polygons.append([i - 1 if i > 0 else len(vertices) + i for i in corners])
        elif words[:1] == [b"surf"]:
            raise ValueError("it holds curved surfaces; export triangles")
    return _triangulated(np.array(vertices, dtype=np.float64).reshape(-1, 3), polygons)


def _triangulated(vertices: Array, polygons: Sequence[Any]) -> tuple[Array, Any]:
    """Cut polygons, (k,) numbers of vertices each, into triangles."""
    sizes = np.array([len(polygon) for polygon in polygons])
    found = []
    for n in range(3, int(sizes.max(initial=0)) + 1):
        faces = np.array([polygons[int(i)] for i in np.flatnonzero(sizes == n)], dtype=np.int64)
        if len(faces) == 0:
            continue
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise ValueError(f"a face names a vertex beyond the {len(vertices)} there are")
        corners = vertices[faces]
        sides = np.roll(corners, -1, axis=1) - corners
        turns = np.cross(sides, np.roll(sides, -1, axis=1))
        normals = np.cross(corners - corners[:, :1], sides).sum(axis=1)
        has_notch = np.any(np.einsum("kni,ki->kn", turns, normals) < 0.0, axis=1) & (n > 3)
        fan = np.stack([np.zeros(n - 2, int), np.arange(1, n - 1), np.arange(2, n)], axis=1)
        found.append(faces[~has_notch][:, fan].reshape(-1, 3))
        found += [faces[i][_ears(corners[i], normals[i])] for i in np.flatnonzero(has_notch)]
    return vertices, np.concatenate(found) if found else np.empty((0, 3), np.int64)


def _ears(corners: Array, normal: Array) -> Any:
    """Cut one polygon with notches, (n, 3); the triangles turn as it does."""
    axes = [(1, 2), (2, 0), (0, 1)][int(np.argmax(np.abs(normal)))]
    flat = np.ascontiguousarray(corners[:, axes])
    ears = mapbox_earcut.triangulate_float64(flat, np.array([len(flat)], np.uint32))
    triangles = ears.reshape(-1, 3).astype(np.int64)
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    return triangles if np.cross(b - a, c - a).sum(axis=0) @ normal >= 0.0 else triangles[:, ::-1]


_DRAWN = ("KHR_materials", "KHR_texture", "KHR_lights", "EXT_texture")
"""Extensions of glTF that change how a surface looks, not where it is."""


def _by_trimesh(kind: str, data: bytes) -> tuple[Array, Any]:
    """Read what trimesh reads rightly; GLB and 3MF in metres, with z up."""
    import trimesh  # slow to import

    if kind not in trimesh.available_formats():
        raise ValueError("networkx and lxml are not installed; export STL or GLB")
    if kind == "gltf":
        _refuse_unread(json.loads(data))
    elif kind == "glb":
        data = _checked_glb(data)
    scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False)
    mesh = scene.to_mesh()
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    if np.any((mesh.faces < 0) | (mesh.faces >= len(vertices))):
        raise ValueError(f"a face names a vertex beyond the {len(vertices)} there are")
    if kind == "3mf":
        vertices = vertices * trimesh.units.unit_conversion(str(scene.units), "meters")
    elif kind != "off":  # y is up
        vertices = vertices[:, [0, 2, 1]] * (1.0, -1.0, 1.0)
    return vertices, np.asarray(mesh.faces)


def _checked_glb(data: bytes) -> bytes:
    """Refuse what trimesh leaves out; put right where Open CASCADE places a part.

    Open CASCADE 7.7 to 8.0 (CadQuery, build123d) turns a part, or a whole assembly, so that y is
    up, but leaves its own place as it was with z up.
    """
    end = 20 + int.from_bytes(data[12:16], "little")
    head = json.loads(data[20:end])
    _refuse_unread(head)
    if not re.match(r"Open CASCADE Technology (7\.[7-9]|8\.0)", head["asset"].get("generator", "")):
        return data
    nodes = [head["nodes"][i] for scene in head["scenes"] for i in scene["nodes"]]
    for node in nodes:
        placed = [key for key in ("rotation", "translation") if key in node]
        for key in placed:
            x, y, z, *w = node[key]
            node[key] = [x, z, -y, *w]
        if not placed:
            nodes += [head["nodes"][i] for i in node.get("children", ())]
    changed = json.dumps(head).encode()
    changed += b" " * (-len(changed) % 4)
    sizes = [len(changed) + len(data) - end + 20, len(changed)]
    return data[:8] + struct.pack("<II", *sizes) + b"JSON" + changed + data[end:]


def _refuse_unread(head: dict[str, Any]) -> None:
    """Refuse glTF of which trimesh would leave something out."""
    needed = [e for e in head.get("extensionsRequired", []) if not e.startswith(_DRAWN)]
    if needed:
        raise ValueError(f"it needs {', '.join(needed)}; export it without compression")
    if any(not e.get("uri", "data:").startswith("data:") for e in head.get("buffers", [])):
        raise ValueError("its numbers are in other files; export GLB")
    if any(p.get("mode") == 6 for mesh in head.get("meshes", []) for p in mesh["primitives"]):
        raise ValueError("it holds fans; export triangles")


# Point clouds


def _ply_points(data: bytes) -> Array:
    """Read the vertices of a PLY file."""
    _refuse_large("ply", data, len(data))
    try:
        return _axes(_read_ply(data)["vertex"])
    except (plyfile.PlyParseError, KeyError, ValueError) as error:
        reason = f"is not a ply file whose points can be read: {clipped(str(error), 200)}"
        raise ConfigError("point_cloud", f"{len(data)} bytes", reason) from error


def _text_points(data: bytes) -> Array:
    """Read the first three numbers of each line; lines of words and comments are left out."""
    rows = [line.replace(b",", b" ").split()[:3] for line in data.splitlines()]
    rows = [row for row in rows if len(row) == 3 and _LETTER.match(row[0]) is None]
    if len(rows) > MOST_POINTS:
        reason = f"has {len(rows)} points, more than the {MOST_POINTS} that are read; thin it out"
        raise ConfigError("point_cloud", f"{len(data)} bytes", reason)
    try:
        return np.array(rows, dtype=np.float64).reshape(-1, 3)
    except ValueError as error:
        reason = "is not a file of points: three numbers a line"
        raise ConfigError("point_cloud", f"{len(data)} bytes", reason) from error


_LETTER = re.compile(rb"[#/A-Za-z_]")


def _around(points: Array, centre: Array | None) -> Array:
    if centre is None or len(points) == 0 or not np.isfinite(points).all():
        return points
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    near = SAME_POINT * (1.0 + float(np.abs(points).max()))
    return points - centre if np.abs(middle - centre).max() <= near else points


_PCD_TYPES = {("F", 4): "<f4", ("F", 8): "<f8"} | {
    (kind, size): f"<{kind.lower()}{size}" for kind in "IU" for size in (1, 2, 4, 8)
}

_WIDEST = 1_024  # most bytes of one point of a cloud; chosen


def _pcd_head(data: bytes) -> tuple[dict[str, list[str]], str, int]:
    """The fields of the head, the format of the points, and the offset of the first."""
    found = re.search(rb"(?:^|\n)DATA ([^\r\n]*)\r?\n", data[:_HEAD])
    if found is None:
        raise ValueError("its header has no DATA line")
    lines = [line.split() for line in data[: found.start()].decode("ascii").splitlines()]
    fields = {words[0]: words[1:] for words in lines if words and not words[0].startswith("#")}
    return fields, found[1].decode("ascii", "replace").strip(), found.end()


def _pcd_count(fields: dict[str, list[str]]) -> int:
    count = fields["POINTS"][0]
    if not re.fullmatch(r"\d+", count):
        raise ValueError(f'POINTS is "{clipped(count, 40)}", not a number of points')
    return int(count[:18])


def _pcd(data: bytes) -> Array:
    fields, form, begin = _pcd_head(data)
    names, count = fields["FIELDS"], _pcd_count(fields)
    counts = [int(number[:4]) for number in fields.get("COUNT", ["1"] * len(names))]
    record = np.dtype(
        [
            (f"{i}", _PCD_TYPES[letter, int(size[:4])], (number,))
            for i, (letter, size, number) in enumerate(
                zip(fields["TYPE"], fields["SIZE"], counts, strict=True)
            )
        ]
    )
    if not 0 < record.itemsize <= _WIDEST:
        raise ValueError(f"a point has {record.itemsize} bytes; at most {_WIDEST} are read")
    axes = [names.index(axis) for axis in "xyz"]
    if form == "ascii":
        table = np.array(data[begin:].split(), dtype=np.float64)
        _refuse_other_count(count, len(table) / sum(counts))
        table = table.reshape(count, -1)
        return np.asarray(table[:, [sum(counts[:i]) for i in axes]])
    if form == "binary_compressed":  # all of the first field, all of the second, ...
        packed, size = (int.from_bytes(data[begin + k : begin + k + 4], "little") for k in (0, 4))
        _refuse_other_count(count, size / record.itemsize)
        body = _unpacked(data[begin + 8 : begin + 8 + packed], size)
        starts = np.cumsum([0, *(record[i].itemsize for i in range(len(names)))]) * count
        columns = [
            np.frombuffer(body, record[i].base, count * counts[i], int(starts[i]))[:: counts[i]]
            for i in axes
        ]
    elif form == "binary":
        if any(data[begin + count * record.itemsize :]):  # PCL fills the last page with zeros
            _refuse_other_count(count, (len(data) - begin) // record.itemsize)
        rows = np.frombuffer(data, record, count, begin)
        columns = [rows[f"{i}"][:, 0] for i in axes]
    else:
        raise ValueError(f"DATA {clipped(form, 40)} is not read here")
    return np.stack([column.astype(np.float64) for column in columns], axis=1)


def _refuse_other_count(head: int, held: float) -> None:
    if head != held:
        raise ValueError(f"its header says {head} points, it has {held:g}")


def _unpacked(data: bytes, size: int) -> bytes:
    """Undo LZF: each item is up to 32 bytes as they are, or a copy of what came before."""
    out, i = bytearray(), 0
    while i < len(data) and len(out) <= size:
        control = data[i]
        i += 1
        if control < 32:
            out += data[i : i + control + 1]
            i += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += data[i]
            i += 1
        start = len(out) - ((control & 31) << 8) - data[i] - 1
        i += 1
        if start < 0:
            raise ValueError("its compressed points are damaged")
        seen = out[start:]  # a copy may run into itself
        out += (seen * ((length + 2) // len(seen) + 1))[: length + 2]
    if len(out) != size:
        raise ValueError(f"{size} bytes were packed, {len(out)} came out; was it cut off?")
    return bytes(out)


def _no_cloud(data: bytes, error: Exception) -> ConfigError:
    reason = f"is not a PCD file: {clipped(str(error), 200)}"
    return ConfigError("point_cloud", f"{len(data)} bytes", reason)
