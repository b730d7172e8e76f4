"""Read and write scenes as JSON: in a file, or in the ``obstacles`` attribute of a component.

Millimetres and degrees, with the unit in every name, in the arm's base frame; ``docs/planning.md``
has an example.

A mesh file is in millimetres unless its format declares a unit (GLB: metres, y up; 3MF); the
optional ``"scale"`` of an entry multiplies the lengths of its shape. An obstacle with
``"mass_kg"`` is an item, which the gripper may take. Attached objects stand in the
tool frame. An error for an unknown name suggests the nearest known
one, and every error names its entry.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from so101_motion.common.attributes import HEAVIEST, Attributes, checked_number
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import LARGEST, SE3, Array
from so101_motion.common.units import to_deg, to_m, to_mm, to_rad
from so101_motion.files import atomic, json_file
from so101_motion.planning.collision.scene import (
    FLOOR_Z,
    MARGIN,
    Attached,
    Box,
    Capsule,
    Cylinder,
    Mesh,
    Obstacle,
    PointCloud,
    Scene,
    Shape,
    Sphere,
    StandingArm,
)
from so101_motion.planning.collision.shape_files import LARGEST_FILE, file_mesh, read_shape

_LARGEST_MM = LARGEST * 1000.0
_SHAPES = (
    *("box_mm", "sphere_radius_mm", "capsule_radius_mm", "cylinder_radius_mm"),
    *("mesh_file", "vertices_mm", "points_mm"),
)
_THING = (
    *("name", "position_mm", "rpy_deg", *_SHAPES),
    *("capsule_length_mm", "cylinder_length_mm", "triangles", "resolution_mm", "scale"),
)

Entry = Mapping[str, Any]
T = TypeVar("T")


def read_scene(path: Path | str) -> Scene:
    """Read a scene file; ``ConfigError`` names what cannot be read or is not valid."""
    content = json_file.read_setting("scene", path := Path(path), LARGEST_FILE)
    return scene_from(content, folder=path.parent)


def write_scene(scene: Scene, path: Path | str) -> None:
    """Write a scene file; meshes become vertices. ``ConfigError`` if it cannot be written."""
    atomic.save("scene", Path(path), (json.dumps(scene_to(scene), indent=2) + "\n").encode())


def scene_from(content: object, *, folder: Path | None = Path()) -> Scene:
    """Make a scene from parsed JSON; ``ConfigError`` names what is not valid.

    Args:
        content: As ``json`` reads it.
        folder: The folder of its mesh files; None to refuse mesh files.
    """
    if not isinstance(content, Mapping):
        raise ConfigError("scene", content, 'must be an object such as {"obstacles": [...]}')
    known = ("floor_z_mm", "margin_mm", "obstacles", "attached", "may_touch")
    given = Attributes(content, known, kind="key of a scene")
    floor_z: float | None = FLOOR_Z
    if "floor_z_mm" in content:
        floor_z = content["floor_z_mm"]
        if floor_z is not None:
            floor_z = to_m(checked_number("floor_z_mm", floor_z, unit="mm"))
    pairs = content.get("may_touch", [])
    if not isinstance(pairs, list) or not all(
        isinstance(pair, list) and len(pair) == 2 and all(isinstance(n, str) for n in pair)
        for pair in pairs
    ):
        raise ConfigError("may_touch", pairs, 'must be a list of pairs, [["cube", "floor"]]')
    margin_mm = given.number("margin_mm", to_mm(MARGIN), lower=0.0, upper=100.0, unit="mm")
    if margin_mm == 0.0:
        raise ConfigError("margin_mm", margin_mm, "must be more than 0 mm")
    return Scene(
        floor_z=floor_z,
        margin=to_m(margin_mm),
        obstacles=obstacles_from(content.get("obstacles", []), folder=folder),
        attached=attached_from(content.get("attached", []), folder=folder),
        may_touch=frozenset(frozenset(pair) for pair in pairs),
    )


def obstacles_from(value: object, *, folder: Path | None = Path()) -> tuple[Obstacle, ...]:
    """Make obstacles from a parsed JSON list; ``folder`` and errors as for ``scene_from``."""

    def made(entry: Entry) -> Obstacle:
        given = Attributes(entry, (*_THING, "keep_out", "mass_kg"), kind="key of an obstacle")
        return Obstacle(
            name=given.text("name", ""),
            shape=_shape(given, entry, folder),
            T_base_obstacle=pose_from(given),
            keep_out=given.flag("keep_out", False),
            mass=_mass(given) if given.given("mass_kg") else None,
        )

    return _all("obstacles", value, made)


def attached_from(value: object, *, folder: Path | None = Path()) -> tuple[Attached, ...]:
    """Make the objects a gripper holds from a parsed JSON list, like ``obstacles_from``."""

    def made(entry: Entry) -> Attached:
        known = (*_THING, "mass_kg", "may_touch", "fixed")
        given = Attributes(entry, known, kind="key of something attached")
        touches = entry.get("may_touch", [])
        if not isinstance(touches, (list, tuple)) or not all(isinstance(n, str) for n in touches):
            raise ConfigError("may_touch", touches, "must be a list of names")
        return Attached(
            name=given.text("name", ""),
            shape=_shape(given, entry, folder),
            T_tool_object=pose_from(given),
            mass=_mass(given),
            may_touch=frozenset(touches),
            fixed=given.flag("fixed", False),
        )

    return _all("attached", value, made)


def attached_to(attached: Iterable[Attached]) -> list[dict[str, object]]:
    """Turn the objects a gripper holds into JSON values; ``attached_from`` reads them back."""
    return [
        {
            **_thing(each.name, read_shape(each.shape), each.T_tool_object),
            "mass_kg": each.mass,
            "may_touch": sorted(each.may_touch),
            **({"fixed": True} if each.fixed else {}),
        }
        for each in attached
    ]


def arms_from(value: object) -> tuple[StandingArm, ...]:
    """Make other arms as obstacles from a parsed JSON list, like ``obstacles_from``."""

    def made(entry: Entry) -> StandingArm:
        known = ("name", "position_mm", "rpy_deg", "room_mm", "q_deg", "attached")
        given = Attributes(entry, known, kind="key of an arm")
        return StandingArm(
            name=given.text("name", ""),
            T_base_arm=pose_from(given),
            q=to_rad(_table("q_deg", entry.get("q_deg"), columns=6)),
            attached=attached_from(entry.get("attached", []), folder=None),
            room=to_m(given.number("room_mm", 0.0, lower=0.0, upper=100.0, unit="mm")),
        )

    return _all("arms", value, made)


def arms_to(arms: Iterable[StandingArm]) -> list[dict[str, object]]:
    return [
        {
            "name": each.name,
            **_placed_at(each.T_base_arm),
            "room_mm": _rounded(to_mm(each.room)),
            "q_deg": to_deg(each.q).round(3).tolist(),
            "attached": attached_to(each.attached),
        }
        for each in arms
    ]


def scene_to(scene: Scene) -> dict[str, object]:
    """Turn a scene into JSON values; ``scene_from`` reads them back."""
    content: dict[str, object] = {
        "floor_z_mm": None if scene.floor_z is None else _rounded(to_mm(scene.floor_z)),
        "margin_mm": _rounded(to_mm(scene.margin)),
        "obstacles": [
            {
                **_thing(o.name, read_shape(o.shape), o.T_base_obstacle),
                **({"keep_out": True} if o.keep_out else {}),
                **({"mass_kg": o.mass} if o.mass is not None else {}),
            }
            for o in scene.obstacles
        ],
    }
    if scene.attached:
        content["attached"] = attached_to(scene.attached)
    if scene.may_touch:
        content["may_touch"] = sorted(sorted(pair) for pair in scene.may_touch)
    return content


# Reading


def _all(key: str, value: object, make: Callable[[Entry], T]) -> tuple[T, ...]:
    """Make something of each entry of a list; an error names the entry, or its index."""
    if not isinstance(value, (list, tuple)):
        raise ConfigError(key, value, "must be a list of objects")
    made = []
    for i, entry in enumerate(value):
        if not isinstance(entry, Mapping):
            reason = 'must be an object such as {"name": "mug", ...}'
            raise ConfigError(f"{key}[{i}]", entry, reason)
        try:
            made.append(make(entry))
        except ConfigError as error:
            of = f'of "{entry["name"]}"' if entry.get("name") else "of one without a name"
            raise ConfigError(error.key, error.value, f"({of}) {error.reason}") from None
    return tuple(made)


def pose_from(given: Attributes) -> SE3:
    position_mm = np.array(given.triple("position_mm", _LARGEST_MM))
    rpy_deg = np.array(given.triple("rpy_deg", 360.0))
    return SE3.from_rpy(to_rad(rpy_deg), to_m(position_mm))


def _shape(given: Attributes, entry: Entry, folder: Path | None) -> Shape:
    forms = [key for key in _SHAPES if given.given(key)]
    if len(forms) != 1:
        reason = f"needs exactly one form, one of {', '.join(_SHAPES)}"
        raise ConfigError("shape", forms or None, reason)
    form = forms[0]
    scale = given.number("scale", 1.0, lower=1e-6, upper=1e6)
    if form == "box_mm":
        edges_mm = np.array(given.triple(form, _LARGEST_MM))
        if not np.all(edges_mm >= 0.0):
            raise ConfigError(form, edges_mm.tolist(), "must be three lengths of 0 mm or more")
        return Box(size=scale * to_m(edges_mm))
    if form == "sphere_radius_mm":
        return Sphere(radius=scale * _length(given, form, may_be_0=True))
    if form == "capsule_radius_mm":
        radius, length = _length(given, form), _length(given, "capsule_length_mm")
        if length < 2.0 * radius:
            reason = f"is from tip to tip, at least twice its radius, {to_mm(2.0 * radius):g} mm"
            raise ConfigError("capsule_length_mm", to_mm(length), reason)
        return Capsule(radius=scale * radius, length=scale * length)
    if form == "cylinder_radius_mm":
        radius, length = _length(given, form), _length(given, "cylinder_length_mm")
        return Cylinder(radius=scale * radius, length=scale * length)
    if form == "mesh_file":
        if folder is None:
            reason = "names a file, which cannot be read here; give vertices_mm"
            raise ConfigError(form, entry[form], reason)
        return _mesh(folder / given.text(form, ""), scale)
    if form == "points_mm":
        resolution = _length(given, "resolution_mm") if given.given("resolution_mm") else 0.01
        points = scale * to_m(_table(form, entry[form]))
        return PointCloud(points=points, resolution=resolution)
    return Mesh(
        vertices=scale * to_m(_table(form, entry[form])),
        triangles=_table("triangles", entry.get("triangles")),
    )


def _mass(given: Attributes) -> float:
    return given.number("mass_kg", 0.0, lower=0.0, upper=HEAVIEST, unit="kg")


def _length(given: Attributes, key: str, *, may_be_0: bool = False) -> float:
    if not given.given(key):
        raise ConfigError(key, None, "is missing")
    length_mm = given.number(key, 0.0, lower=0.0, upper=_LARGEST_MM, unit="mm")
    if length_mm == 0.0 and not may_be_0:
        raise ConfigError(key, length_mm, "must be more than 0 mm")
    return to_m(length_mm)


def _table(key: str, value: object, columns: int = 3) -> Array:
    try:
        table = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        table = np.empty(0)
    if table.ndim != 2 or table.shape[1] != columns or not np.all(np.isfinite(table)):
        rows = "triples of" if columns == 3 else f"rows of {columns}"
        raise ConfigError(key, "...", f"must be a list of {rows} finite numbers")
    return table


def _mesh(path: Path, scale: float) -> Mesh:
    """Read a mesh file; where its format declares no unit, in millimetres."""
    try:
        size = path.stat().st_size
        data = path.read_bytes() if size <= LARGEST_FILE else b""
        if not data:
            raise ConfigError("mesh", f"{size} bytes", f"must be 1 to {LARGEST_FILE} bytes")
        return file_mesh(path.suffix.lower()[1:], data, scale=scale)
    except OSError as error:
        reason = f"cannot be read: {error.strerror}"
        raise ConfigError("mesh_file", str(path), reason) from error
    except ConfigError as error:
        raise ConfigError("mesh_file", str(path), f"({error.value}) {error.reason}") from error


# Writing


def _thing(name: str, shape: Shape, pose: SE3) -> dict[str, object]:
    return {"name": name, **_form(shape), **_placed_at(pose)}


def _placed_at(pose: SE3) -> dict[str, object]:
    entry: dict[str, object] = {"position_mm": [_rounded(x) for x in to_mm(pose.p)]}
    rpy = pose.rpy
    if np.any(rpy != 0.0):
        entry["rpy_deg"] = [float(a) for a in to_deg(rpy)]
    return entry


def _form(shape: Shape) -> dict[str, object]:
    if isinstance(shape, Box):
        return {"box_mm": [_rounded(x) for x in to_mm(shape.size)]}
    if isinstance(shape, (Sphere, Capsule, Cylinder)):
        kind = type(shape).__name__.lower()
        names = ("radius",) if isinstance(shape, Sphere) else ("radius", "length")
        return {f"{kind}_{name}_mm": _rounded(to_mm(getattr(shape, name))) for name in names}
    if isinstance(shape, PointCloud):
        return {
            "points_mm": to_mm(shape.points).tolist(),
            "resolution_mm": _rounded(to_mm(shape.resolution)),
        }
    return {"vertices_mm": to_mm(shape.vertices).tolist(), "triangles": shape.triangles.tolist()}


def _rounded(length_mm: float) -> float:
    return round(float(length_mm), 6)
