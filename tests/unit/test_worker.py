import dataclasses
import io
import math
import os
import signal
import threading

import numpy as np
import pytest

from so101_motion.errors import OutsideLimits, WorkerError
from so101_motion.geometry import SE3
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.plan import PlanRequest
from so101_motion.planning.scene import Obstacle, PointCloud, Scene
from so101_motion.worker import PlanningWorker, Receiver, Scenes, Sender

LIMITS = MotionLimits.uniform(velocity=1.5, acceleration=3.0, jerk=30.0)


@pytest.fixture(scope="module")
def worker():
    worker = PlanningWorker()
    worker.start().result()
    yield worker
    worker.close()


def request_to(q_deg):
    q_goal = np.radians(q_deg)
    return PlanRequest(q_start=np.zeros(5), goal=JointGoal(q=q_goal), limits=LIMITS)


def test_a_plan_comes_back_as_it_was_made(worker):
    plan = worker.plan(request_to([20.0, 0.0, 0.0, 0.0, 0.0])).result()
    np.testing.assert_allclose(plan.trajectory.q[-1], np.radians([20.0, 0.0, 0.0, 0.0, 0.0]))
    assert not plan.trajectory.q.flags.writeable


def test_a_child_is_deaf_to_ctrl_c_from_its_first_moment():
    worker = PlanningWorker()
    ready = worker.start()
    pause = threading.Event()
    while worker.pid is None:
        pause.wait(0.001)
    os.kill(worker.pid, signal.SIGINT)  # as a terminal does to all that run in it
    ready.result()
    worker.close()


def test_an_error_comes_back_with_its_fields(worker):
    with pytest.raises(OutsideLimits) as caught:
        worker.plan(request_to([0.0, 0.0, 95.0, 0.0, 0.0])).result()
    assert caught.value.joint == "elbow_flex"
    assert caught.value.value == pytest.approx(math.radians(95.0))


def test_a_worker_that_died_is_started_again(worker):
    first = worker.pid
    os.kill(first, signal.SIGKILL)
    os.waitid(os.P_PID, first, os.WEXITED | os.WNOWAIT)
    worker.plan(request_to([5.0, 0.0, 0.0, 0.0, 0.0])).result()
    assert worker.pid != first


def test_dying_while_it_plans_is_an_error_not_a_hang(worker):
    worker.plan(request_to([5.0, 0.0, 0.0, 0.0, 0.0])).result()
    os.kill(worker.pid, signal.SIGSTOP)  # so that the request is certainly under way
    answer = worker.plan(request_to([5.0, 0.0, 0.0, 0.0, 0.0]))
    os.kill(worker.pid, signal.SIGKILL)
    with pytest.raises(WorkerError, match="try once more"):
        answer.result()
    worker.plan(request_to([5.0, 0.0, 0.0, 0.0, 0.0])).result()


def test_a_closed_worker_says_so_and_leaves_no_process():
    worker = PlanningWorker()
    worker.start().result()
    pid = worker.pid
    worker.close()
    worker.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    with pytest.raises(RuntimeError):
        worker.plan(request_to([0.0] * 5))


def big_scene():
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (5000, 3))
    here = SE3.from_translation((0.0, 0.35, 0.2))
    cloud = PointCloud(points=points, resolution=0.01)
    return Scene(obstacles=(Obstacle(name="cloud", shape=cloud, T_base_obstacle=here),))


def test_a_scene_is_sent_once_and_known_by_its_content():
    sent, scenes, received = io.BytesIO(), Scenes(), Scenes()
    sizes = []
    for _ in range(3):
        sent.seek(0)
        sent.truncate()
        request = dataclasses.replace(request_to([5.0, 0.0, 0.0, 0.0, 0.0]), scene=big_scene())
        Sender(sent, scenes).dump(request)
        sizes.append(sent.tell())
        sent.seek(0)
        assert Receiver(sent, received).load().scene == request.scene
    assert sizes[0] > 100_000
    assert sizes[1] == sizes[2] < 3_000


def test_both_ends_forget_the_same_scenes():
    sent, scenes, received = io.BytesIO(), Scenes(), Scenes()
    rng = np.random.default_rng(0)
    some = [Scene(margin=0.001 * (k + 1)) for k in range(20)]
    for k in rng.integers(0, len(some), 300):
        sent.seek(0)
        sent.truncate()
        Sender(sent, scenes).dump((some[k], some[(k + 1) % 20]))
        sent.seek(0)
        assert Receiver(sent, received).load() == (some[k], some[(k + 1) % 20])


def test_a_worker_that_died_is_told_the_scene_again(worker):
    request = dataclasses.replace(request_to([5.0, 0.0, 0.0, 0.0, 0.0]), scene=big_scene())
    first = worker.plan(request).result()
    died = worker.pid
    os.kill(died, signal.SIGKILL)
    os.waitid(os.P_PID, died, os.WEXITED | os.WNOWAIT)
    again = worker.plan(request).result()
    assert np.array_equal(first.trajectory.q, again.trajectory.q)
