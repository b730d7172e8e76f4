"""The visual meshes: closed, small, of the arm's size, readable, reproducible."""

import struct

import numpy as np
import pytest
import so101_description as description
from so101_description.generator.glb import to_linear
from so101_description.make_meshes import MATERIALS, make
from so101_description.mesh_readers import read_glb, to_srgb

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


@pytest.mark.parametrize("part", ALL)
def test_normals_are_unit_and_lie_on_their_triangles_side(part):
    for surface in description.load_visual(part):
        assert np.linalg.norm(surface.normals, axis=1) == pytest.approx(1.0, abs=1e-6)
        a, b, c = (surface.mesh.vertices[surface.mesh.faces[:, i]] for i in range(3))
        area = np.cross(b - a, c - a)
        facing = area / np.maximum(np.linalg.norm(area, axis=1, keepdims=True), 1e-12)
        wide = np.linalg.norm(area, axis=1) > 1e-10  # m2; a sliver has no direction
        for i in range(3):
            normals = surface.normals[surface.mesh.faces[:, i]]
            assert np.all(np.sum(normals * facing, axis=1)[wide] > 0.3), surface.name


def test_meshes_are_light():
    arm = [s for part in description.PARTS.values() for s in description.load_visual(part)]
    assert sum(len(surface.mesh.faces) for surface in arm) <= 30_000
    files = list(description.MESH_DIR.iterdir())
    assert sum(file.stat().st_size for file in files if file.suffix == ".glb") < 1_500_000
    assert sum(file.stat().st_size for file in files) < 2_000_000


def test_the_folder_holds_the_meshes_and_nothing_else():
    names = {f"{part}.glb" for part in ALL}
    names |= {f"{part}_hull.obj" for part in description.PARTS.values()}
    assert {file.name for file in description.MESH_DIR.iterdir()} == names


def test_colours_survive_the_linear_encoding():
    for part in ALL:
        for surface in description.load_visual(part):
            srgb = np.array(MATERIALS[surface.name].srgb) / 255
            assert surface.color == pytest.approx(srgb, abs=1e-4)
    assert to_srgb(to_linear(0.02)) == pytest.approx(0.02)


def test_every_link_shows_its_servo_and_the_jaw_has_none():
    for part in description.PARTS.values():
        names = {surface.name for surface in description.load_visual(part)}
        assert ("servo" in names) == (part != "jaw")
        assert names & {"print", "accent"}


def test_unknown_parts_are_refused_by_name():
    with pytest.raises(ValueError, match="no part 'elbow'; known: base, shoulder"):
        description.load_visual("elbow")
    with pytest.raises(ValueError, match="no part 'axes'"):
        description.load_hull("axes")


def test_reader_refuses_other_files(tmp_path):
    other = tmp_path / "old.glb"
    other.write_bytes(struct.pack("<III", 0x46546C67, 1, 12))
    with pytest.raises(ValueError, match="not a binary glTF 2"):
        read_glb(other)


def test_loaded_arrays_cannot_be_written():
    surface = description.load_visual("jaw")[0]
    with pytest.raises(ValueError, match="read-only"):
        surface.mesh.vertices[0] = 0.0


@pytest.mark.parametrize("part", ["upper_arm", "axes"])  # all of them take half a minute
def test_making_a_part_again_gives_the_committed_bytes(part, tmp_path):
    make(part, tmp_path)
    again = (tmp_path / f"{part}.glb").read_bytes()
    assert again == (description.MESH_DIR / f"{part}.glb").read_bytes()
