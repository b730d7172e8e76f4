"""A scene as a WorldState's JSON, read back with Viam's own package."""

from __future__ import annotations

import asyncio
import io
import json

import numpy as np
import pytest
from google.protobuf import json_format
from hypothesis import given
from hypothesis import strategies as st
from viam.proto.common import Geometry, Pose, WorldState
from viam.proto.common import Mesh as ViamMesh

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import (
    Attached,
    Box,
    Capsule,
    Mesh,
    Obstacle,
    PointCloud,
    Scene,
    Shape,
    Sphere,
)
from so101_motion.planning.collision.shape_files import read_shape
from so101_motion.viam.conversion.frames import Frames
from so101_motion.viam.conversion.geometries import from_geometry, to_geometry, world_state_json
from so101_motion.viam.conversion.world_state import scene_with

TOOL = SE3.from_rpy((0.4, 1.0, -0.2), (0.3, 0.1, 0.2))
CORNERS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
SHAPES: tuple[Shape, ...] = (
    Box(size=np.array([0.02, 0.03, 0.04])),
    Sphere(radius=0.05),
    Capsule(radius=0.01, length=0.2),
    Mesh(vertices=CORNERS, triangles=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])),
    PointCloud(points=CORNERS),
)

lengths = st.floats(-1.0, 1.0)
angles = st.floats(-3.1, 3.1)
poses = st.builds(
    SE3.from_rpy, st.tuples(angles, st.floats(-1.5, 1.5), angles), st.tuples(*[lengths] * 3)
)


def read(said: object) -> WorldState:
    """As Viam reads it, through text."""
    return json_format.Parse(json.dumps(said), WorldState())


def planned_with(world: WorldState, *, arm: str) -> Scene:
    """What our motion service plans with when a request says this."""
    frames = Frames(arm, TOOL, world.transforms)
    return asyncio.run(scene_with(Scene(), world, frames))


@given(poses, st.sampled_from(SHAPES), st.text(min_size=1, max_size=20))
def test_what_stands_around_is_where_and_what_it_was(pose: SE3, shape: Shape, name: str) -> None:
    there = Obstacle(name=f"a {name}", shape=shape, T_base_obstacle=pose)
    world = read(world_state_json(Scene(obstacles=(there,)), arm="left"))
    (again,) = planned_with(world, arm="left").obstacles
    assert again.name == there.name
    if isinstance(shape, PointCloud):
        seen = read_shape(again.shape).points @ again.T_base_obstacle.R.T + again.T_base_obstacle.p
        np.testing.assert_allclose(seen, shape.points @ pose.R.T + pose.p, atol=1e-6)
        return
    # Within a degree of straight up or down viam-server forgets which way the tilt goes.
    np.testing.assert_allclose(again.T_base_obstacle.p, pose.p, atol=2e-9)
    np.testing.assert_allclose(again.T_base_obstacle.R, pose.R, atol=0.03)
    assert to_geometry(again.shape, "") == to_geometry(shape, "")


def test_meshes_are_text_which_viam_server_reads_and_clouds_have_no_centre_of_their_own() -> None:
    mesh = to_geometry(SHAPES[3], "part").mesh
    assert mesh.mesh.startswith(b"ply\nformat ascii 1.0\n")
    there = [Obstacle(name=f"{i}", shape=SHAPES[i], T_base_obstacle=TOOL) for i in (3, 4)]
    (group,) = read(world_state_json(Scene(obstacles=tuple(there)))).obstacles
    assert group.geometries[0].mesh == mesh
    assert group.geometries[1].center == Pose(o_z=1.0), "a cloud's points are where they are"
    assert read(world_state_json(Scene())) == WorldState()


@pytest.mark.parametrize(
    ("kind", "said"), [("ply", "ply"), ("ply", "stl"), ("stl", "ply"), ("stl_ascii", "ply")]
)
def test_a_mesh_file_from_a_client_goes_back_as_text(kind: str, said: str) -> None:
    """viam-server calls every mesh PLY."""
    import trimesh

    sent = trimesh.creation.box((0.1, 0.2, 0.3)).export(file_type=kind)
    data = sent.encode() if isinstance(sent, str) else sent
    shape = from_geometry(Geometry(mesh=ViamMesh(content_type=said, mesh=data)))

    back = to_geometry(shape, "part").mesh

    assert back.content_type == "ply"
    assert back.mesh.startswith(b"ply\nformat ascii 1.0\n")
    again = trimesh.load_mesh(io.BytesIO(back.mesh), file_type="ply")
    np.testing.assert_allclose(again.bounds, [[-0.05, -0.1, -0.15], [0.05, 0.1, 0.15]], atol=1e-6)
    assert again.volume == pytest.approx(0.1 * 0.2 * 0.3)


@pytest.mark.parametrize("shape", SHAPES)
def test_what_is_held_hangs_from_the_tool(shape: Shape) -> None:
    held = Attached(name="cube", shape=shape, T_tool_object=TOOL, mass=0.1)
    world = read(world_state_json(Scene(attached=(held,)), arm="left"))
    (again,) = planned_with(world, arm="left").attached
    np.testing.assert_allclose(again.T_tool_object.matrix, TOOL.matrix, atol=1e-7)
    assert again.name == "cube"
