"""Read meshes and point clouds from files (STL, PLY, PCD, XYZ), and simplify meshes.

A file of a million triangles takes a second to read. So a request handler reads only its head
(``shape_file``) and passes its bytes on; the planning process reads the rest (``read_shape``). The
head says how large the content is, and too much is refused before anything is read. Binary files
are read here with numpy; other mesh files by trimesh, which takes half a second to import.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from so101_motion.common.errors import ConfigError, clipped
from so101_motion.common.geometry import Array
from so101_motion.planning.collision.scene import Mesh, PointCloud, Shape, ShapeFile

MOST_TRIANGLES = 300_000
"""Most triangles of a mesh. Chosen: the tree over them is made in half a second."""

MOST_POINTS = 1_000_000
"""Most points of a cloud, or vertices of a mesh; chosen: a depth camera of 1280x720."""

LARGEST_FILE = 32 << 20
"""Largest file that is read [byte]: the largest message of viam-server."""

SAME_POINT = 1e-6
"""Largest distance at which a centre counts as the middle of a cloud's points [m], and the same as
a share of the largest coordinate: viam-server computes it from floats of 32 bits."""

_HEAD = 65_536
"""Longest head of a file [byte]. Chosen; heads have some hundred."""


def shape_file(
    kind: str, data: bytes | memoryview, *, name: str, centre: Array | None = None
) -> ShapeFile:
    """Check the head of a mesh or cloud in metres, and wrap its bytes for the planner.

    Raises:
        ConfigError: It is too large, or its head cannot be read.
    """
    _refuse_large(kind, bytes(data[:_HEAD]), len(data))
    return ShapeFile(kind=kind, data=np.frombuffer(data, np.uint8), name=name, centre=centre)


def read_shape(shape: Shape | ShapeFile) -> Shape:
    """Read the shape in a file; returns any other shape as it is.

    Raises:
        ConfigError: The file cannot be read; the message has its name.
    """
    if not isinstance(shape, ShapeFile):
        return shape
    data = shape.data.tobytes()
    try:
        if shape.kind == "pcd":
            return PointCloud(points=_around(read_points(data), shape.centre))
        vertices, triangles = read_mesh(shape.kind, data)
        return Mesh(vertices=vertices, triangles=triangles)
    except ConfigError as error:
        raise ConfigError(error.key, error.value, f"(of {shape.name}) {error.reason}") from error


def mesh_kind(data: bytes | memoryview) -> str:
    """The kind of a mesh file, by its content: ``"ply"`` or ``"stl"``.

    A binary STL file has any 80 bytes, the number of its triangles, and 50 bytes for each.

    Raises:
        ConfigError: It is neither.
    """
    head = bytes(data[:_HEAD])
    words = head.split(maxsplit=1)[:1]
    if words == [b"ply"]:
        return "ply"
    if _is_binary_stl(head, len(data)) or [word.lower() for word in words] == [b"solid"]:
        return "stl"
    raise ConfigError("mesh", f"{len(data)} bytes", "must be a PLY or STL file")


def read_mesh(kind: str, data: bytes, *, most: int = MOST_TRIANGLES) -> tuple[Array, Any]:
    """Read vertices (n, 3) and triangles (m, 3), at most ``most``, in the file's unit.

    Raises:
        ConfigError: It is too large, or no such file.
    """
    _refuse_large(kind, data, len(data), most)
    try:
        found = _binary_stl(data) if kind == "stl" else _binary_ply(data)
        if found is None:
            found = _any_mesh(kind, data)
    except Exception as error:  # trimesh's readers raise whatever they trip over
        raise ConfigError(
            "mesh", f"{len(data)} bytes", f"is not a {kind} file: {clipped(str(error), 200)}"
        ) from error
    if len(found[1]) == 0:
        raise ConfigError("mesh", f"{len(data)} bytes", "holds no triangles; is it a mesh?")
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

    All vertices of a grid cell become one at their mean; triangles that collapse are left out.

    Args:
        meshes: Vertices (n, 3), [m], and triangles (m, 3) of each, in one frame.
        grid: Edge of a cell [m].
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
    """Read the points of a PCD file from Viam's cameras, shape (n, 3), [m].

    Raises:
        ConfigError: It is too large, or no such file.
    """
    _refuse_large("pcd", data, len(data))
    try:
        return _pcd(data)
    except (KeyError, ValueError, IndexError, OverflowError) as error:
        raise _no_cloud(data, error) from error


def read_cloud(kind: str, data: bytes) -> Array:
    """Read the points of a PCD, PLY or XYZ file, shape (n, 3), in its unit; n >= 1.

    Points that are not finite, as cameras write them where they see nothing, are left out.

    Raises:
        ConfigError: It is too large, or no such file.
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
    return _count(_ply_head(data)[0], rb"element face (\d+)") > 0


def _refuse_large(kind: str, data: bytes, size: int, most_triangles: int = MOST_TRIANGLES) -> None:
    """Refuse a file of ``size`` bytes with too much content.

    ``data`` is all of it or its head; STL text has no head, so only the given part is counted.
    """
    what = "point_cloud" if kind == "pcd" else "mesh"
    if size > LARGEST_FILE:
        raise ConfigError(
            what, f"{size} bytes", f"is larger than the {LARGEST_FILE} bytes that are read"
        )
    if kind == "stl":
        counts = {"triangles": (_stl_count(data, size), most_triangles)}
    elif kind == "ply":
        head, _ = _ply_head(data)
        counts = {
            "triangles": (_count(head, rb"element face (\d+)"), most_triangles),
            "vertices": (_count(head, rb"element vertex (\d+)"), MOST_POINTS),
        }
    else:
        try:
            counts = {"points": (_pcd_count(_pcd_head(data)[0]), MOST_POINTS)}
        except (KeyError, ValueError, IndexError) as error:
            raise _no_cloud(data, error) from error
    for unit, (count, most) in counts.items():
        if count > most:
            raise ConfigError(
                what,
                f"{size} bytes",
                f"has {count:.7g} {unit}, more than the {most} that are read; simplify it or cut it"
                " to the part that the arm can reach",
            )


# Meshes


def _is_binary_stl(head: bytes, size: int) -> bool:
    return size >= 84 and size == 84 + 50 * int.from_bytes(head[80:84], "little")


def _stl_count(data: bytes, size: int) -> int:
    if _is_binary_stl(data, size):
        return int.from_bytes(data[80:84], "little")
    return data.count(b"endfacet") + data.count(b"ENDFACET")


def _binary_stl(data: bytes) -> tuple[Array, Any] | None:
    if not _is_binary_stl(data, len(data)):
        return None
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    corners = np.frombuffer(data, record, offset=84)["corners"]
    return corners.reshape(-1, 3).astype(np.float64), np.arange(3 * len(corners)).reshape(-1, 3)


def _ply_head(data: bytes) -> tuple[bytes, int]:
    """The head of a PLY file, and its length with its last line."""
    end = re.search(rb"\nend_header\r?\n", data[:_HEAD])
    if end is None:
        raise ConfigError("mesh", f"{len(data)} bytes", "is not a ply file: its head has no end")
    return data[: end.start()].replace(b"\r", b""), end.end()


def _count(head: bytes, pattern: bytes) -> int:
    found = re.search(pattern, head)
    return int(found[1][:18]) if found else 0


_PLY_TYPES = {
    "char": "<i1", "uchar": "<u1", "short": "<i2", "ushort": "<u2", "int": "<i4", "uint": "<u4",
    "int8": "<i1", "uint8": "<u1", "int16": "<i2", "uint16": "<u2", "int32": "<i4",
    "uint32": "<u4", "float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8",
}  # fmt: skip


def _binary_ply(data: bytes) -> tuple[Array, Any] | None:
    """Read the usual form: little-endian, vertices, then triangles only; None for other forms."""
    head, begin = _ply_head(data)
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    lines = [words for words in lines if words and words[0] not in ("comment", "obj_info")]
    elements = [words for words in lines if words[0] == "element"]
    if lines[1][1:2] != ["binary_little_endian"] or [e[1] for e in elements] != ["vertex", "face"]:
        return None
    at = lines.index(elements[1])
    columns, faces = lines[lines.index(elements[0]) + 1 : at], lines[at + 1 :]
    if len(faces) != 1 or faces[0][1:2] != ["list"]:
        return None
    vertex = np.dtype([(words[2], _PLY_TYPES[words[1]]) for words in columns])
    number, corner = (_PLY_TYPES[word] for word in faces[0][2:4])
    face = np.dtype([("n", number), ("corners", corner, 3)])
    counts = [int(words[2]) for words in elements]
    if len(data) != begin + counts[0] * vertex.itemsize + counts[1] * face.itemsize:
        return None
    vertices = np.frombuffer(data, vertex, counts[0], begin)
    faces_ = np.frombuffer(data, face, counts[1], begin + vertices.nbytes)
    if not np.all(faces_["n"] == 3):
        return None
    points = np.stack([vertices[axis].astype(np.float64) for axis in "xyz"], axis=1)
    return points, faces_["corners"].astype(np.int64)


def _any_mesh(kind: str, data: bytes) -> tuple[Array, Any]:
    import trimesh  # many formats, and slow to import

    mesh = trimesh.load_mesh(io.BytesIO(data), file_type=kind)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


# Point clouds


def _ply_points(data: bytes) -> Array:
    """Read the vertices of a PLY file in which they come first."""
    _refuse_large("ply", data, len(data))
    head, begin = _ply_head(data)
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    words = [line for line in lines if line and line[0] in ("format", "element", "property")]
    try:
        assert words[0][0] == "format"
        assert words[1][:2] == ["element", "vertex"]
        rest = [k for k, line in enumerate(words[2:], 2) if line[0] == "element"]
        columns = [(line[2], line[1]) for line in words[2 : rest[0] if rest else None]]
        count, form = int(words[1][2]), words[0][1]
        if form == "ascii":
            rows = data[begin:].split(b"\n", count)[:count]
            names = [name for name, _ in columns]
            table = np.array([row.split()[: len(names)] for row in rows], dtype=np.float64)
            return np.asarray(table[:, [names.index(axis) for axis in "xyz"]])
        order = {"binary_little_endian": "<", "binary_big_endian": ">"}[form]
        record = np.dtype([(name, order + _PLY_TYPES[kind][1:]) for name, kind in columns])
        found = np.frombuffer(data, record, count, begin)
        return np.stack([found[axis].astype(np.float64) for axis in "xyz"], axis=1)
    except (AssertionError, IndexError, KeyError, ValueError) as error:
        reason = "is not a ply file whose points can be read"
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


_PCD_TYPES = {("F", 4): "<f4", ("F", 8): "<f8", ("I", 4): "<i4", ("U", 4): "<u4"} | {
    (kind, size): f"<{code}{size}" for kind, code in (("I", "i"), ("U", "u")) for size in (1, 2)
}

_WIDEST = 1_024
"""Most bytes of one point of a cloud; chosen."""


def _pcd_head(data: bytes) -> tuple[dict[str, list[str]], str, int]:
    """The fields of the head, the format of the points, and the offset of the first."""
    found = re.search(rb"(?:^|\n)DATA ([^\r\n]*)\r?\n", data[:_HEAD])
    if found is None:
        raise ValueError("its head has no DATA")
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
    columns = [names.index(axis) for axis in "xyz"]
    if form == "ascii":
        table = np.array(data[begin:].split(), dtype=np.float64).reshape(count, -1)
        return np.asarray(table[:, columns])
    if form != "binary":
        raise ValueError(f"DATA {clipped(form, 40)} is not read here")
    counts = fields.get("COUNT", ["1"] * len(names))
    record = np.dtype(
        [
            (f"{i}", _PCD_TYPES[letter, int(size[:4])], (int(number[:4]),))
            for i, (letter, size, number) in enumerate(
                zip(fields["TYPE"], fields["SIZE"], counts, strict=True)
            )
        ]
    )
    if not 0 < record.itemsize <= _WIDEST:
        raise ValueError(f"a point has {record.itemsize} bytes, 1 to {_WIDEST} are read")
    rows = np.frombuffer(data, record, count, begin)
    return np.stack([rows[f"{i}"][:, 0].astype(np.float64) for i in columns], axis=1)


def _no_cloud(data: bytes, error: Exception) -> ConfigError:
    reason = f"is not a PCD file: {clipped(str(error), 200)}"
    return ConfigError("point_cloud", f"{len(data)} bytes", reason)
