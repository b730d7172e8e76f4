from __future__ import annotations

import numpy as np
import pytest
from so101_viewer.scene.click import hit

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Box, Capsule, Obstacle, Scene, Sphere

DOWN = np.array([0.0, 0.0, -2.0])  # of any length


def scene(shape: object, floor_z: float | None = 0.0) -> Scene:
    thing = Obstacle(
        name="thing",
        shape=shape,  # type: ignore[arg-type]
        T_base_obstacle=SE3.from_translation(np.array([0.2, 0.0, 0.1])),
    )
    return Scene(obstacles=(thing,), floor_z=floor_z)


@pytest.mark.parametrize(
    ("shape", "top"),
    [
        (Box(size=np.array([0.1, 0.1, 0.04])), 0.12),
        (Sphere(radius=0.03), 0.13),
        (Capsule(radius=0.02, length=0.1), 0.15),
    ],
)
def test_a_click_from_above_meets_the_top_of_a_thing_or_the_floor(
    shape: object, top: float
) -> None:
    around = scene(shape)
    met = hit(around, np.array([0.2, 0.0, 1.0]), DOWN)
    assert met is not None
    np.testing.assert_allclose(met, [0.2, 0.0, top], atol=0.003)
    met = hit(around, np.array([0.4, 0.1, 1.0]), DOWN)
    assert met is not None
    np.testing.assert_allclose(met, [0.4, 0.1, 0.0], atol=1e-9)


def test_a_slanting_click_meets_the_nearest_side() -> None:
    around = scene(Box(size=np.array([0.1, 0.1, 0.04])))
    met = hit(around, np.array([1.0, 0.0, 0.1]), np.array([-1.0, 0.0, 0.0]))
    assert met is not None
    np.testing.assert_allclose(met, [0.25, 0.0, 0.1], atol=1e-9)


def test_a_click_into_the_air_meets_nothing() -> None:
    around = scene(Sphere(radius=0.03), floor_z=None)
    assert hit(around, np.array([0.4, 0.1, 1.0]), DOWN) is None
    assert hit(scene(Sphere(radius=0.03)), np.array([0.0, 0.0, 0.5]), -DOWN) is None
