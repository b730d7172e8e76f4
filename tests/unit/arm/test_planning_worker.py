import contextlib
import dataclasses
import math
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import CancelledError
from pathlib import Path

import numpy as np
import pytest
from harness import endless_plan

from so101_motion.arm.planning_worker import SHARE, PlanningWorker
from so101_motion.common.errors import ConfigError, NoPath, OutsideLimits, WorkerError
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Obstacle, PointCloud, Scene
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

LIMITS = MotionLimits.uniform(velocity=1.5, acceleration=3.0, jerk=30.0)


@contextlib.contextmanager
def started(*settings, **more):
    worker = PlanningWorker(*settings, **more)
    worker.start().result()
    yield worker
    worker.close()


@pytest.fixture(scope="module")
def worker():
    with started() as worker:
        yield worker


def pid_of(worker):
    """Of its child, None while there is none."""
    return next(iter(worker.pids), None)


def request_to(q_deg):
    q_goal = np.radians(q_deg)
    return PlanRequest(q_start=np.zeros(5), goal=JointGoal(q=q_goal), limits=LIMITS)


EASY = request_to([5.0, 0.0, 0.0, 0.0, 0.0])


def test_a_child_is_deaf_to_ctrl_c_from_its_first_moment():
    worker = PlanningWorker()
    ready = worker.start()
    pause = threading.Event()
    while pid_of(worker) is None:
        pause.wait(0.001)
    pid = pid_of(worker)
    os.kill(pid, signal.SIGINT)  # as a terminal does to all that run in it
    ready.result()
    for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(pid, each)
    worker.plan(EASY).result()
    assert pid_of(worker) == pid
    worker.close()


def test_an_error_comes_back_with_its_fields(worker):
    with pytest.raises(OutsideLimits) as caught:
        worker.plan(request_to([0.0, 0.0, 95.0, 0.0, 0.0])).result()
    assert caught.value.joint == "elbow_flex"
    assert caught.value.value == pytest.approx(math.radians(95.0))


def endless_request():
    """A plan that is searched in vain for a minute."""
    return PlanRequest(
        q_start=endless_plan.Q_START,
        goal=JointGoal(q=endless_plan.Q_GOAL),
        limits=LIMITS,
        scene=endless_plan.SCENE,
        time_budget=60.0,
    )


def wait_until(happened, seconds=60.0):
    pause, begin = threading.Event(), time.monotonic()
    while not happened():
        assert time.monotonic() < begin + seconds
        pause.wait(0.002)


def processor_time(pid):
    """What a process has used so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


def begin_endless(worker):
    """Have it plan in vain, and wait until it certainly does."""
    used = processor_time(pid_of(worker))
    answer = worker.plan(endless_request())
    wait_until(lambda: processor_time(pid_of(worker)) > used + 0.05)
    return answer


def test_a_child_that_always_dies_is_reported(worker, caplog):
    worker.start().result()
    os.kill(pid_of(worker), signal.SIGSTOP)  # or it may answer before it is killed
    answer = worker.plan(EASY)
    while not answer.done():
        with contextlib.suppress(ProcessLookupError, TypeError):
            os.kill(pid_of(worker), signal.SIGKILL)
    with pytest.raises(
        WorkerError, match=r"failed \d times in a row; the last one was ended by SIGK"
    ):
        answer.result()
    assert caplog.records[-1].levelname == "ERROR"
    worker.plan(EASY).result()


def test_a_child_that_cannot_even_start_is_reported(monkeypatch, caplog):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    worker = PlanningWorker()
    with pytest.raises(WorkerError, match="the last one ended with exit code 1"):
        worker.start().result()
    worker.close()
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    worker = PlanningWorker()
    with pytest.raises(WorkerError, match="could not be started"):
        worker.plan(EASY).result()
    worker.close()


def test_a_request_may_be_cancelled_at_any_moment(worker):
    worker.start().result()
    pid, pause = pid_of(worker), threading.Event()
    random = np.random.default_rng(0)
    for wait in random.uniform(0.0, 0.02, 20):
        answer = worker.plan(dataclasses.replace(endless_request(), time_budget=0.01))
        pause.wait(wait)
        answer.cancel()
        assert worker.plan(EASY).result(60.0).duration > 0.0
    assert pid_of(worker) == pid


def test_closing_ends_every_plan_with_an_error_of_ours():
    worker = PlanningWorker()
    worker.start().result()
    pid = pid_of(worker)
    answers = [begin_endless(worker), *(worker.plan(endless_request()) for _ in range(8))]
    begin = time.monotonic()
    worker.close()
    worker.close()
    assert not is_alive(pid)
    assert time.monotonic() < begin + 20.0, "not the 60 s of one of them"
    for answer in [*answers, worker.plan(request_to([0.0] * 5)), worker.start()]:
        with pytest.raises(WorkerError, match="open it again"):
            answer.result(0.0)


@pytest.fixture(scope="module")
def impatient():
    with started(hang_timeout=1.5) as worker:  # a busy machine may keep it from a sign of life
        yield worker


def test_a_child_that_hung_while_idle_is_replaced_and_the_next_plan_is_made(impatient, caplog):
    hung = pid_of(impatient)
    os.kill(hung, signal.SIGSTOP)
    request = dataclasses.replace(EASY, scene=big_scene())
    assert impatient.plan(request).result(60.0).duration > 0.0
    assert pid_of(impatient) != hung
    assert "no sign of life" in caplog.text


def test_a_child_that_computes_for_long_does_not_hang(impatient):
    pid = pid_of(impatient)
    request = dataclasses.replace(endless_request(), time_budget=1.9)
    with pytest.raises(NoPath):
        impatient.plan(request).result()
    assert pid_of(impatient) == pid


PARENT = """
import sys, time
sys.path[:0] = sys.argv[1].split()
from test_planning_worker import endless_request, pid_of
from so101_motion.arm.planning_worker import PlanningWorker
worker = PlanningWorker(copies=sys.argv[2] == "copied")
if sys.argv[2] == "starting":
    worker.start()
    while pid_of(worker) is None:
        time.sleep(0.001)
    time.sleep(0.2)
else:
    worker.start().result()
    for _ in range(3):
        worker.plan(endless_request())
    while len(worker.pids) < 4:
        time.sleep(0.01)
print(*worker.pids, flush=True)
time.sleep(60)
"""


def state_of(pid):
    """R runs, S sleeps; Z also if it has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return "Z"


def is_alive(pid):
    return state_of(pid) != "Z"


@pytest.mark.parametrize(("busy", "count"), [("starting", 1), ("copied", 4)])
def test_all_children_end_when_their_parent_is_killed(busy, count):
    folders = f"{Path(__file__).parent} {Path(__file__).parents[2]}"
    command = [sys.executable, "-c", PARENT, folders, busy]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        pids = [int(each) for each in parent.stdout.readline().split()]
        assert len(pids) == count
        assert all(map(is_alive, pids))
        parent.kill()
    wait_until(lambda: not any(map(is_alive, pids)), 30.0)  # not the 60 s for which it would plan


def test_nothing_in_the_current_folder_is_executed(tmp_path, monkeypatch):
    for name in ("numpy", "pinocchio", "json", "sitecustomize", "so101_motion"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'executed')!r}, 'w')")
    monkeypatch.chdir(tmp_path)
    for known_by in ("", str(tmp_path), "."):
        monkeypatch.syspath_prepend(known_by)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(tmp_path), "")))
    with started():
        pass
    assert not (tmp_path / "executed").exists()


@pytest.fixture(scope="module")
def pair():
    with started(workers=2) as worker:
        list(worker.plan_many([EASY] * 2))  # both are started
        yield worker


def test_many_plans_come_in_order_from_two_children_errors_among_them(pair):
    angles = [5.0, 95.0, -5.0, 10.0, 0.0, 95.0]
    batch = pair.plan_many([request_to([0.0, 0.0, each, 0.0, 0.0]) for each in angles])
    assert len(batch) == len(angles)
    for degrees, outcome in zip(angles, batch, strict=True):
        if degrees == 95.0:
            assert isinstance(outcome, OutsideLimits)
        else:
            assert outcome.q_goal[2] == pytest.approx(math.radians(degrees))
    assert len(pair.pids) == 2


def test_a_batch_that_is_given_up_ends_at_once_in_both_children(pair):
    pids = pair.pids
    used = {pid: processor_time(pid) for pid in pids}
    batch = pair.plan_many([endless_request()] * 5)
    wait_until(lambda: all(processor_time(pid) > used[pid] + 0.05 for pid in pids))
    batch.cancel()
    with pytest.raises(CancelledError):
        list(batch)
    assert pair.plan(EASY).result(60.0).duration > 0.0
    assert pair.pids == pids


def test_one_of_two_that_dies_is_replaced_and_no_plan_is_lost(pair):
    victim = pair.pids[0]
    os.kill(victim, signal.SIGSTOP)  # so that it does not finish what it is given
    batch = pair.plan_many([request_to([each, 0.0, 0.0, 0.0, 0.0]) for each in (5, 6, 7, 8)])
    assert batch.plans[3].result(60.0).duration > 0.0  # by the other
    os.kill(victim, signal.SIGKILL)
    assert [round(math.degrees(plan.q_goal[0])) for plan in batch] == [5, 6, 7, 8]
    wait_until(lambda: victim not in pair.pids)


def test_no_workers_at_all_are_refused():
    with pytest.raises(ConfigError, match="workers"):
        PlanningWorker(workers=0)


def big_scene():
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (5000, 3))
    here = SE3.from_translation((0.0, 0.35, 0.2))
    cloud = PointCloud(points=points, resolution=0.01)
    return Scene(obstacles=(Obstacle(name="cloud", shape=cloud, T_base_obstacle=here),))


def test_a_worker_that_dies_while_it_plans_is_replaced_by_one_that_gets_the_scene_again(
    worker, caplog
):
    request = dataclasses.replace(EASY, scene=big_scene())
    first = worker.plan(request).result()
    died = pid_of(worker)
    os.kill(died, signal.SIGSTOP)  # so that the request is certainly under way
    answer = worker.plan(request)
    os.kill(died, signal.SIGKILL)
    again = answer.result()
    assert pid_of(worker) != died
    assert "SIGKILL" in caplog.text
    assert "replaced" in caplog.text
    assert np.array_equal(first.trajectory.q, again.trajectory.q)


@pytest.fixture
def shared():
    with started(copies=True) as worker:
        yield worker


def test_an_easy_request_never_waits_for_a_hard_one(shared):
    hard = [shared.plan(endless_request(), owner="a") for _ in range(8)]
    for k in range(20):
        if k % 2:  # the oldest is superseded
            hard.pop(0).cancel()
            hard.append(shared.plan(endless_request(), owner="a"))
        begin = time.monotonic()
        assert shared.plan(EASY, owner="b").result(60.0).duration
        assert time.monotonic() < begin + 30.0, "not the 60 s of one of them"
    assert not any(each.done() for each in hard)
    wait_until(lambda: len(shared.pids) == 1 + SHARE + 1)  # one waits
    main, *copies = shared.pids
    wait_until(lambda: state_of(main) == "S")  # it sleeps, and so makes copies at once
    for each in hard:
        each.cancel()
    wait_until(lambda: len(shared.pids) == 2)
    kept = shared.pids
    wait_until(lambda: not any(map(is_alive, {*copies} - {*kept})))
    assert shared.plan(EASY).result(60.0).duration > 0.0
    assert shared.pids == kept == (main, kept[1])


def test_what_is_asked_before_the_first_child_is_ready_waits_for_it_and_not_for_its_plan():
    worker = PlanningWorker(copies=True)
    hard = worker.plan(endless_request(), owner="a")
    assert worker.plan(EASY, owner="b").result(60.0).duration > 0.0
    assert not hard.done()
    worker.close()


def test_a_copy_that_dies_or_hangs_is_replaced_and_its_plan_is_made(caplog):
    worker = PlanningWorker(1.5, copies=True)
    worker.start().result()
    hard = worker.plan(endless_request(), owner="a")
    for end in (signal.SIGKILL, signal.SIGSTOP):
        easy = worker.plan(dataclasses.replace(endless_request(), time_budget=1.0), owner="b")
        wait_until(lambda: len(worker.pids) == 3)
        os.kill(worker.pids[2], end)
        with pytest.raises(NoPath):
            easy.result(60.0)
    assert "ended" in caplog.text
    assert "no sign of life" in caplog.text
    assert not hard.done()
    worker.close()


def test_an_original_that_hangs_holds_up_nobody(caplog):
    worker = PlanningWorker(1.5, copies=True)
    worker.start().result()
    hard = worker.plan(endless_request(), owner="a")
    wait_until(lambda: len(worker.pids) == 2)
    os.kill(pid_of(worker), signal.SIGSTOP)
    assert worker.plan(EASY, owner="b").result(60.0).duration > 0.0
    hard.cancel()
    worker.close()
