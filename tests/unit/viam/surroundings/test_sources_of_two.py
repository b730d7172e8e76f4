"""A store or camera that both the arm and its motion service name."""

import logging
from dataclasses import replace
from types import SimpleNamespace

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Obstacle, Scene, Sphere
from so101_motion.viam.surroundings.camera_view import CameraView
from so101_motion.viam.surroundings.store_watch import StoreWatch
from so101_motion.viam.surroundings.surroundings import Surroundings

LOGGER = logging.getLogger("test")


class Machine:
    """A machine without components."""

    is_asked, without, company = True, "", ()

    async def read(self):
        return SimpleNamespace(bodies=())


class Source:
    """Reports a ball each time it is asked."""

    is_steady = True

    def __init__(self, *origin):
        self.origin = origin

    async def added_to(self, scene, view):
        name = f"ball {len(scene.obstacles)}"
        ball = Obstacle(name=name, shape=Sphere(radius=0.01), T_base_obstacle=SE3.identity())
        return replace(scene, obstacles=(*scene.obstacles, ball))


async def test_its_things_are_in_a_plan_once():
    surroundings = Surroundings(Machine(), [Source("store", "seen")], LOGGER)
    same, other = Source("store", "seen"), Source("store", "more")
    assert len((await surroundings.around(Scene(), (same,))).obstacles) == 1
    assert len((await surroundings.around(Scene(), (same, other))).obstacles) == 2


def test_one_is_known_by_what_it_reads():
    assert StoreWatch("seen", None, LOGGER).origin == StoreWatch("seen", None, LOGGER).origin
    top = CameraView("top", None)
    assert top.origin == CameraView("top", None).origin
    assert top.origin != CameraView("top", None, "finder").origin
    assert top.origin != StoreWatch("top", None, LOGGER).origin
