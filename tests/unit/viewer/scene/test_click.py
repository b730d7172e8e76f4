import numpy as np
import pytest
from so101_viewer.scene.scene_view import hit

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import (
    Box,
    Capsule,
    Mesh,
    Obstacle,
    PointCloud,
    Scene,
    Sphere,
)

DOWN = np.array([0.0, 0.0, -2.0])  # of any length
PYRAMID = Mesh(
    vertices=0.01 * np.array([[4, 4, 0], [-4, 4, 0], [-4, -4, 0], [4, -4, 0], [0, 0, 6]]),
    triangles=np.array([[0, 1, 2], [2, 3, 0], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]),
)


def scene(shape, floor_z=0.0):
    thing = Obstacle(
        name="thing",
        shape=shape,
        T_base_obstacle=SE3.from_translation(np.array([0.2, 0.0, 0.1])),
    )
    return Scene(obstacles=(thing,), floor_z=floor_z)


@pytest.mark.parametrize(
    ("shape", "top"),
    [
        (Box(size=np.array([0.1, 0.1, 0.04])), 0.12),
        (Sphere(radius=0.03), 0.13),
        (Capsule(radius=0.02, length=0.1), 0.15),
        (PYRAMID, 0.16),
        (PointCloud(points=[[0.003, 0.003, 0.012], [0.1, 0.1, 0.1]], resolution=0.01), 0.12),
    ],
)
def test_a_click_from_above_meets_the_top_of_a_thing_or_the_floor(shape, top):
    around = scene(shape)
    met = hit(around, np.array([0.2, 0.0, 1.0]), DOWN)
    assert met is not None
    np.testing.assert_allclose(met, [0.2, 0.0, top], atol=0.003)
    met = hit(around, np.array([0.4, 0.1, 1.0]), DOWN)
    assert met is not None
    np.testing.assert_allclose(met, [0.4, 0.1, 0.0], atol=1e-9)


def test_a_click_meets_the_side_of_a_box_a_mesh_and_a_cloud_that_is_towards_it():
    level = np.array([-1.0, 0.0, 0.0])
    met = hit(scene(Box(size=np.array([0.1, 0.1, 0.04]))), np.array([1.0, 0.0, 0.1]), level)
    np.testing.assert_allclose(met, [0.25, 0.0, 0.1], atol=1e-9)
    met = hit(scene(PYRAMID), np.array([1.0, 0.0, 0.13]), level)
    assert met is not None
    np.testing.assert_allclose(met, [0.22, 0.0, 0.13], atol=1e-9)  # half its height, half its width
    cloud = PointCloud(points=[[x, 0.005, 0.005] for x in (-0.05, 0.0, 0.05)], resolution=0.02)
    met = hit(scene(cloud), np.array([1.0, 0.01, 0.11]), level)
    assert met is not None
    np.testing.assert_allclose(met, [0.26, 0.01, 0.11], atol=1e-9)
    assert hit(scene(cloud, floor_z=None), np.array([1.0, 0.03, 0.11]), level) is None


def test_a_click_into_the_air_meets_nothing():
    around = scene(Sphere(radius=0.03), floor_z=None)
    assert hit(around, np.array([0.4, 0.1, 1.0]), DOWN) is None
    assert hit(scene(Sphere(radius=0.03)), np.array([0.0, 0.0, 0.5]), -DOWN) is None
