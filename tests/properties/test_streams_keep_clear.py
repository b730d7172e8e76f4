"""In random scenes no stream touches anything."""

import numpy as np
import pytest
from harness.random_scenes import random_scene
from harness.setpoints import swing

from so101_motion.arm.open_ended_motions import GUARDED_STOP
from so101_motion.common.errors import MotionError
from so101_motion.control.streamed_trajectory import Stream
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.differential.guard import Guard
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.rig import HARD_STOP

DT, SCENES = 0.01, 3
MODEL = RobotModel.load()


def caps(speed, acceleration):
    acceleration = np.radians(acceleration)
    return MotionLimits.uniform(
        velocity=np.radians(speed), acceleration=acceleration, jerk=10.0 * acceleration
    )


SLOW, FAST = caps(50.0, 200.0), caps(180.0, 400.0)


def played(points, scene, limits, ahead):
    """The setpoints, the stop included, and why it ended early, if it did."""
    guard = Guard(CollisionModel(MODEL, scene), lambda: 0.0, acceleration=GUARDED_STOP.acceleration)
    stream = Stream(
        q_start=points[0].q, limits=limits, dt=DT, stop_limits=GUARDED_STOP, guard=guard
    )
    q, sent, now = [], 0, stream.start
    while not stream.is_over:
        while sent < len(points) and points[sent].t <= len(q) * DT + ahead:
            stream.push([points[sent]])
            sent += 1
            if sent == len(points):
                stream.finish()
        try:
            now = stream.sample(len(q))
        except MotionError as error:
            return np.array([*q, *stream.brake(now, HARD_STOP).q[1:]]), error
        q.append(now.q)
    return np.array(q), None


def two_free(rng, collision):
    """Two configurations without contact; None if they are hard to find."""
    tried = (rng.uniform(MODEL.lower, MODEL.upper) for _ in range(300))
    free = [q for q in tried if collision.is_free(q)][:2]
    return free if len(free) == 2 else None


@pytest.mark.parametrize(("limits", "ahead"), [(SLOW, 2.0), (FAST, 2.0), (FAST, 0.22)])
def test_what_nobody_has_planned_touches_nothing(limits, ahead):
    rng, stopped = np.random.default_rng(2), 0
    for _ in range(SCENES):
        collision, ends = None, None
        while ends is None or collision.first_blocked(np.array(ends)) is None:
            scene = random_scene(rng, count=3)  # until something is in the way
            collision = CollisionModel(MODEL, scene)
            ends = two_free(rng, collision)
        way = float(np.abs(ends[1] - ends[0]).max())
        seconds = max(2.0 * way / limits.velocity[0], np.sqrt(12.0 * way / limits.acceleration[0]))
        q, error = played(swing(*ends, seconds), scene, limits, ahead)
        stopped += error is not None
        assert min(collision.distances(each).min() for each in q[::2]) > 0.0
    assert stopped > 1
