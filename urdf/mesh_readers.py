"""Readers for the two mesh formats this package ships, with numpy alone.

Not general: ``read_glb`` understands the files ``make_meshes.py`` writes (one node per surface,
no transforms, no textures), ``read_obj`` the triangles ``make_hulls.py`` writes. In return the
whole arm is read in a few milliseconds and nothing heavy is imported.
"""

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_GLB_MAGIC: Final = 0x46546C67  # "glTF"; glTF 2.0 specification, section 4.4.2
_CHUNK_JSON: Final = 0x4E4F534A  # section 4.4.3
_CHUNK_BINARY: Final = 0x004E4942

# glTF 2.0, section 3.6.2.2: component types and the number of components of each accessor type.
_DTYPES: Final = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS: Final = {"SCALAR": 1, "VEC3": 3}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriangleMesh:
    """Triangles in a link's frame.

    Attributes:
        vertices: Shape (n, 3), [m].
        faces: Vertex indices, counter-clockwise seen from outside, shape (m, 3).
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]

    def __post_init__(self) -> None:
        self.vertices.setflags(write=False)
        self.faces.setflags(write=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """One material's share of a link, ready to be drawn.

    Attributes:
        name: Material: ``print``, ``accent``, ``servo`` or ``horn``; a marker's axis.
        mesh: The triangles; vertices are repeated along sharp edges.
        normals: Unit normals of the vertices, shape (n, 3).
        color: Red, green, blue as sRGB, each 0 to 1.
    """

    name: str
    mesh: TriangleMesh
    normals: NDArray[np.float64]
    color: tuple[float, float, float]

    def __post_init__(self) -> None:
        self.normals.setflags(write=False)


def read_glb(path: Path) -> tuple[Surface, ...]:
    """Read the surfaces of a binary glTF file that ``make_meshes.py`` wrote.

    Args:
        path: The ``.glb`` file.

    Returns:
        Its surfaces, in file order.

    Raises:
        ValueError: The file is not binary glTF 2.
    """
    data = path.read_bytes()
    magic, version, _ = struct.unpack_from("<III", data)
    if magic != _GLB_MAGIC or version != 2:
        raise ValueError(f"{path} is not a binary glTF 2 file")
    chunks: dict[int, bytes] = {}
    offset = 12
    while offset < len(data):
        length, kind = struct.unpack_from("<II", data, offset)
        chunks[kind] = data[offset + 8 : offset + 8 + length]
        offset += 8 + length
    document: dict[str, Any] = json.loads(chunks[_CHUNK_JSON])
    binary = chunks[_CHUNK_BINARY]
    return tuple(
        _surface(document, binary, mesh["name"], primitive)
        for mesh in document["meshes"]
        for primitive in mesh["primitives"]
    )


def _surface(
    document: Mapping[str, Any], binary: bytes, name: str, primitive: Mapping[str, Any]
) -> Surface:
    material = document["materials"][primitive["material"]]
    red, green, blue, _ = material["pbrMetallicRoughness"]["baseColorFactor"]
    attributes = primitive["attributes"]
    vertices = _array(document, binary, attributes["POSITION"])
    faces = _array(document, binary, primitive["indices"])
    return Surface(
        name=name,
        mesh=TriangleMesh(
            vertices=vertices.astype(np.float64), faces=faces.astype(np.int32).reshape(-1, 3)
        ),
        normals=_array(document, binary, attributes["NORMAL"]).astype(np.float64),
        color=(to_srgb(red), to_srgb(green), to_srgb(blue)),
    )


def _array(document: Mapping[str, Any], binary: bytes, index: int) -> NDArray[Any]:
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    width = _WIDTHS[accessor["type"]]
    flat = np.frombuffer(
        binary,
        dtype=_DTYPES[accessor["componentType"]],
        count=accessor["count"] * width,
        offset=view.get("byteOffset", 0) + accessor.get("byteOffset", 0),
    )
    return flat.reshape(-1, width) if width > 1 else flat


def to_srgb(linear: float) -> float:
    """Encode one linear colour component for a screen.

    Args:
        linear: Light intensity, 0 to 1, as glTF stores it.

    Returns:
        The sRGB component, 0 to 1.

    Source: IEC 61966-2-1.
    """
    if linear <= 0.0031308:
        return 12.92 * linear
    return float(1.055 * linear ** (1 / 2.4) - 0.055)


def read_obj(path: Path) -> TriangleMesh:
    """Read the triangles of a Wavefront OBJ file that ``make_hulls.py`` wrote.

    Args:
        path: The ``.obj`` file, lines ``v x y z`` and ``f a b c`` only (and comments).

    Returns:
        Its triangles.
    """
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    for line in path.read_text(encoding="ascii").splitlines():
        if line.startswith("v "):
            vertices.append([float(word) for word in line.split()[1:]])
        elif line.startswith("f "):
            faces.append([int(word) - 1 for word in line.split()[1:]])
    return TriangleMesh(
        vertices=np.array(vertices, dtype=np.float64), faces=np.array(faces, dtype=np.int32)
    )
