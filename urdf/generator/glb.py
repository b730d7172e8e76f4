"""Write binary glTF: one node, mesh and material per surface, with positions and normals only."""

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from .shading import shaded


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """The look of a surface.

    Attributes:
        name: Name of the material and of its mesh in the file.
        srgb: Red, green, blue as one would write them in a style sheet, 0 to 255.
        metallic: 0 for plastic.
        roughness: 0 mirror, 1 chalk.
    """

    name: str
    srgb: tuple[int, int, int]
    metallic: float = 0.0
    roughness: float = 0.6


@dataclass(frozen=True, slots=True, kw_only=True)
class GlbSize:
    """The size of a written file."""

    triangles: int
    size_bytes: int


def write_glb(path: Path, surfaces: list[tuple[Material, Manifold]]) -> GlbSize:
    """Shade solids and write them as one file, in metres.

    Args:
        path: The file to write.
        surfaces: Solids in millimetres, one per material, in file order.

    Returns:
        The number of triangles and of bytes.
    """
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "so101_motion urdf/make_meshes.py"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(surfaces)))}],
        "nodes": [],
        "meshes": [],
        "materials": [],
        "accessors": [],
        "bufferViews": [],
    }
    binary = bytearray()
    triangles = 0
    for i, (material, solid) in enumerate(surfaces):
        vertices, normals, faces = shaded(*_closed(solid))
        triangles += len(faces)
        index_type = np.uint16 if len(vertices) < 2**16 else np.uint32
        document["nodes"].append({"mesh": i, "name": material.name})
        document["materials"].append(_material(material))
        document["meshes"].append(
            {
                "name": material.name,
                "primitives": [
                    {
                        "attributes": {
                            "POSITION": _append(
                                document, binary, (vertices * 1e-3).astype(np.float32), bounds=True
                            ),
                            "NORMAL": _append(document, binary, normals.astype(np.float32)),
                        },
                        "indices": _append(document, binary, faces.ravel().astype(index_type)),
                        "material": i,
                    }
                ],
            }
        )
    document["buffers"] = [{"byteLength": len(binary)}]
    data = _container(json.dumps(document, separators=(",", ":")).encode(), bytes(binary))
    path.write_bytes(data)
    return GlbSize(triangles=triangles, size_bytes=len(data))


def to_linear(component: float) -> float:
    """Decode one sRGB component, 0 to 1, to the light intensity glTF stores.

    Source: IEC 61966-2-1; glTF 2.0, section 3.9.2 (``baseColorFactor`` is linear).
    """
    if component <= 0.04045:
        return component / 12.92
    return float(((component + 0.055) / 1.055) ** 2.4)


def _closed(solid: Manifold) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The surface on a grid of 1 um, so that single precision cannot tear it open."""
    mesh = solid.simplify(0.01).to_mesh64()
    snapped = np.round(np.asarray(mesh.vert_properties)[:, :3], 3) + 0.0
    vertices, index = np.unique(snapped, axis=0, return_inverse=True)
    faces = index.ravel()[np.asarray(mesh.tri_verts, dtype=np.int64)]
    following = np.roll(faces, -1, axis=1)
    return vertices, faces[np.all(faces != following, axis=1)]


def _material(material: Material) -> dict[str, Any]:
    return {
        "name": material.name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*(round(to_linear(c / 255), 6) for c in material.srgb), 1.0],
            "metallicFactor": material.metallic,
            "roughnessFactor": material.roughness,
        },
    }


def _append(
    document: dict[str, Any], binary: bytearray, array: NDArray[Any], *, bounds: bool = False
) -> int:
    """Append an array to the buffer; the index of its accessor."""
    is_index = array.ndim == 1
    accessor: dict[str, Any] = {
        "bufferView": len(document["bufferViews"]),
        "componentType": {"u2": 5123, "u4": 5125, "f4": 5126}[array.dtype.str[1:]],
        "count": len(array),
        "type": "SCALAR" if is_index else "VEC3",
    }
    if bounds:
        accessor["min"] = [float(x) for x in array.min(axis=0)]
        accessor["max"] = [float(x) for x in array.max(axis=0)]
    document["accessors"].append(accessor)
    data = array.tobytes()
    document["bufferViews"].append(
        {
            "buffer": 0,
            "byteOffset": len(binary),
            "byteLength": len(data),
            "target": 34963 if is_index else 34962,
        }
    )
    binary += data + bytes(-len(data) % 4)
    return int(accessor["bufferView"])


def _container(document: bytes, binary: bytes) -> bytes:
    """Wrap the two chunks as glTF 2.0, section 4.4 asks for."""
    document += b" " * (-len(document) % 4)
    length = 12 + 8 + len(document) + 8 + len(binary)
    return (
        struct.pack("<III", 0x46546C67, 2, length)
        + struct.pack("<II", len(document), 0x4E4F534A)
        + document
        + struct.pack("<II", len(binary), 0x004E4942)
        + binary
    )
