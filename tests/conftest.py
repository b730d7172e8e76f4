"""Fixtures that more than one test directory needs."""

import gc
import logging
import signal
import sys
import threading
from dataclasses import dataclass

import numpy as np
import pytest
from harness import lanes
from harness.clocks import pace_simulated_arms
from harness.heard_port import hear_terminals_of_this_process
from harness.setpoints import TapedArm
from hypothesis import settings
from hypothesis.internal.conjecture import providers
from referee.official import refereed

from so101_motion.common.clock import ManualClock
from so101_motion.control.executor import Executor
from so101_motion.control.streamed_trajectory import Stream
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Trajectory
from so101_motion.rig.simulated_rig import open_simulated

# Deadlines would be timed tests; a failure prints how to repeat it.
settings.register_profile("so101", deadline=None, print_blob=True)
settings.load_profile("so101")

_SEED_OPTION = "hypothesis_seed"


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config):
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        # In the background of a script; the programs under test would not hear Ctrl-C either.
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if getattr(config.option, _SEED_OPTION, None) is None:
        setattr(config.option, _SEED_OPTION, "0")  # what passes once passes again
        # Without constants from the code that happens to be imported: they depend on which tests
        # a worker ran before.
        constants = providers.Constants()
        providers._get_local_constants = lambda: constants
    if hasattr(config, "workerinput"):
        config.pluginmanager.register(lanes.Yielding(config.workerinput))


def pytest_addoption(parser):
    parser.addoption(
        "--hardware",
        metavar="PORT",
        help="an arm on this port instead of an emulated one; it WILL move, a little",
    )
    parser.addoption(
        "--examples", metavar="N", type=int, help="so many for each law, whatever it asks for"
    )


def pytest_report_header(config):
    lines = [f"hypothesis seed: --hypothesis-seed={getattr(config.option, _SEED_OPTION)}"]
    port = config.getoption("--hardware")
    if port:
        lines.append(f"THE ARM ON {port} WILL MOVE: up to 15 deg from where it stands, and its jaw")
    return lines


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    return lanes.Lanes(config, log) if config.getvalue("dist") == "loadfile" else None


def pytest_collection_modifyitems(config, items):
    """With an arm, only what is written for one: it uses ``arm_port`` and troubles no servo."""
    if examples := config.getoption("--examples"):
        for item in items:
            if hasattr(item.obj, "hypothesis"):
                held = item.obj._hypothesis_internal_use_settings
                item.obj._hypothesis_internal_use_settings = settings(held, max_examples=examples)
            item.own_markers = [mark for mark in item.own_markers if mark.name != "timeout"]
    if hasattr(config, "workerinput"):
        items[:] = lanes.longest_first(items)
    if not config.getoption("--hardware"):
        return
    left_out = [
        item
        for item in items
        if "arm_port" not in item.fixturenames or item.get_closest_marker("emulator_only")
    ]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item not in left_out]


@pytest.fixture(autouse=True)
def nobody_silences_the_log():
    """A test that left the log switched off would hide what later tests look for."""
    yield
    names = ("so101_motion", *(n for n in logging.root.manager.loggerDict if "so101_motion." in n))
    loggers = {name: logging.getLogger(name) for name in names}
    silent = [n for n, log in loggers.items() if log.disabled or log.level > logging.ERROR]
    for name in silent:
        logging.getLogger(name).disabled = False
        logging.getLogger(name).setLevel(logging.NOTSET)
    assert silent == []


@pytest.fixture(scope="session")
def arm_port(request):
    """The port of a real arm; None for an emulated one. Who uses it is written for both."""
    return request.config.getoption("--hardware")


@pytest.fixture(autouse=True)
def no_thread_outlives_its_test():
    before = set(threading.enumerate())
    yield
    left = [
        thread
        for thread in threading.enumerate()
        if thread.name.startswith("so101-") and thread not in before
    ]
    for thread in left:
        thread.join(30.0)  # one that was told to end may still be on its way out
    alive = [thread.name for thread in left if thread.is_alive()]
    assert not alive, f"threads outlive the test: {alive}"


@pytest.fixture(autouse=True)
def referee(request):
    """Watches every emulated arm of the test; what breaks a rule fails it.

    A test that breaks one on purpose says so: ``@pytest.mark.breaks("motion", reason="...")``.
    """
    meant = {rule for mark in request.node.iter_markers("breaks") for rule in mark.args}
    with refereed(meant) as referee:
        yield referee


@pytest.fixture(autouse=True, scope="module")
def old_objects_are_not_looked_through_while_servos_answer():
    """A whole run's process has so many that one look by the collector takes a second or two."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True, scope="module")
def arms_of_verbs_in_this_process_are_forgotten():
    """Else the next error that is printed here tells what they do."""
    yield
    if "so101_motion.cli.shared" in sys.modules:
        sys.modules["so101_motion.cli.shared"].opened.clear()


@pytest.fixture(autouse=True, scope="session")
def emulated_servos_of_this_process_are_always_heard():
    with pytest.MonkeyPatch.context() as patch:
        hear_terminals_of_this_process(patch)
        yield


@pytest.fixture(autouse=True, scope="session")
def simulated_arms_of_this_process_lose_no_setpoint():
    with pytest.MonkeyPatch.context() as patch:
        pace_simulated_arms(patch.setattr)
        yield


@pytest.fixture(autouse=True, scope="session")
def no_second_copies_in_the_home_of_whoever_runs_the_tests(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(tmp_path_factory.mktemp("data")))
        yield


@pytest.fixture(scope="session")
def planning_process():
    """Keep the planning process between tests; starting it for each would cost a second."""
    with open_simulated(clock=ManualClock()) as rig:
        rig.arm.plan(JointGoal(q=np.full(5, 0.1)))
        yield


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def data(tmp_path, monkeypatch):
    """The module's data directory."""
    monkeypatch.setenv("VIAM_MODULE_DATA", str(tmp_path))
    return tmp_path


LIMITS = MotionLimits.uniform(velocity=1.5, acceleration=5.0, jerk=50.0)
STOP_LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=8.0, jerk=200.0)


@dataclass
class SimExecutor:
    """An executor on a simulated arm whose time a test moves by hand."""

    clock: ManualClock
    arm: TapedArm
    executor: Executor
    dt: float = 0.01
    limits: MotionLimits = LIMITS
    stop_limits: MotionLimits = STOP_LIMITS

    @property
    def state(self):
        return self.executor.state

    def to_goal(self, q_goal, q_start=None):
        """A straight move from where the arm is wanted now, or from ``q_start``."""
        q_start = self.state.q_ref if q_start is None else q_start
        return online.point_to_point(q_start, q_goal, self.limits, self.dt)

    def slow_move(self, duration=10.0):
        """A smooth move of joint 1 by half a turn that takes ``duration`` seconds."""
        u = np.arange(round(duration / self.dt) + 1) * self.dt / duration
        q, qd, qdd = np.zeros((3, len(u), 5))
        q[:, 0] = np.pi * (10 * u**3 - 15 * u**4 + 6 * u**5)
        qd[:, 0] = np.pi * 30 * u**2 * (1 - u) ** 2 / duration
        qdd[:, 0] = np.pi * 60 * u * (1 - u) * (1 - 2 * u) / duration**2
        return Trajectory(dt=self.dt, q=q, qd=qd, qdd=qdd, duration=duration)

    def stream(self):
        """A stream that is played from now on."""
        return self.executor.play(Stream(q_start=self.state.q_ref, limits=self.limits, dt=self.dt))

    def after(self, dt, future):
        """What ``future`` holds once ``dt`` seconds have passed; it must be done by then."""
        self.clock.advance(dt)
        return future.result(timeout=0)

    def error_after(self, dt, future):
        """What ``future`` has failed with once ``dt`` seconds have passed."""
        self.clock.advance(dt)
        return future.exception(timeout=0)


@pytest.fixture
def taped_arm():
    """The class of arm that ``sim`` moves, for tests that give it a temper."""
    return TapedArm


@pytest.fixture
def make_sim(clock):
    """Makes executors on simulated arms and closes them when the test is over."""
    made = []

    def make(arm=None, **settings):
        arm = arm or TapedArm(clock)
        executor = Executor(
            arm, clock, dt=0.01, stop_limits=STOP_LIMITS, name="so101-io-test", **settings
        )
        made.append(executor)
        return SimExecutor(clock=clock, arm=arm, executor=executor)

    yield make
    for executor in made:
        executor.close()


@pytest.fixture
def sim(make_sim):
    rig = make_sim()
    rig.executor.start()
    return rig
