"""A scene as a WorldState's JSON: read by Viam's own package it is the scene again."""

from __future__ import annotations

import asyncio
import json

import numpy as np
import pytest
from google.protobuf import json_format
from hypothesis import given
from hypothesis import strategies as st
from viam.proto.common import WorldState

from so101_motion.geometry import SE3
from so101_motion.models.frames import Frames
from so101_motion.models.geometries import to_geometry
from so101_motion.models.world_state import scene_with
from so101_motion.models.world_state_json import world_state_json
from so101_motion.planning.scene import (
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


def planned_with(world: WorldState, *, arm: str = "arm") -> Scene:
    """What our motion service plans with when a request says this."""
    frames = Frames(arm, TOOL, world.transforms)
    return asyncio.run(scene_with(Scene(), world, frames))


@given(poses, st.sampled_from(SHAPES), st.text(min_size=1, max_size=20))
def test_what_stands_around_is_where_and_what_it_was(pose: SE3, shape: Shape, name: str) -> None:
    there = Obstacle(name=f"a {name}", shape=shape, T_base_obstacle=pose)
    world = read(world_state_json(Scene(obstacles=(there,))))
    (again,) = planned_with(world).obstacles
    assert again.name == there.name
    # Within a degree of straight up or down viam-server forgets which way the tilt goes.
    np.testing.assert_allclose(again.T_base_obstacle.p, pose.p, atol=2e-9)
    np.testing.assert_allclose(again.T_base_obstacle.R, pose.R, atol=0.03)
    assert to_geometry(again.shape, "") == to_geometry(shape, "")


@pytest.mark.parametrize("shape", SHAPES)
def test_what_is_held_hangs_from_the_tool(shape: Shape) -> None:
    held = Attached(name="cube", shape=shape, T_tool_object=TOOL, mass=0.1)
    world = read(world_state_json(Scene(attached=(held,)), arm="left"))
    (again,) = planned_with(world, arm="left").attached
    np.testing.assert_allclose(again.T_tool_object.matrix, TOOL.matrix, atol=1e-7)
    assert again.name == "cube"


def test_what_stands_is_seen_from_the_base_of_the_arm_that_was_named() -> None:
    zone = Obstacle(
        name="zone", shape=SHAPES[0], T_base_obstacle=SE3.from_translation((0.25, 0, 0.1)),
        keep_out=True,
    )  # fmt: skip
    assert world_state_json(Scene(obstacles=(zone,)), arm="left") == {
        "obstacles": [
            {
                "referenceFrame": "left_origin",
                "geometries": [
                    {
                        "center": {
                            "x": 250.0, "y": 0.0, "z": 100.0,
                            "oX": 0.0, "oY": 0.0, "oZ": 1.0, "theta": 0.0,
                        },
                        "box": {"dimsMm": {"x": 20.0, "y": 30.0, "z": 40.0}},
                        "label": "zone",
                    }
                ],
            }
        ]
    }  # fmt: skip


def test_an_empty_scene_is_an_empty_world() -> None:
    assert read(world_state_json(Scene())) == WorldState()
