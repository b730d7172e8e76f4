"""Running after a target, through the executor on a clock the test drives."""

import numpy as np
import pytest

from so101_motion.common.errors import FollowingError, Interrupted, MotionError
from so101_motion.common.modes import Mode
from so101_motion.control.joint_group import Channel
from so101_motion.control.target_tracking import Pursuit, TrackingTarget
from so101_motion.planning.timing.limits import MotionLimits

CAPS = MotionLimits.uniform(velocity=2.0, acceleration=6.0, jerk=150.0)
LOWER, UPPER = np.full(5, -1.0), np.full(5, 1.0)


class Hare:
    """A target; what it was told about the one behind it is on ``seen``."""

    def __init__(self, clock, motion):
        self.clock, self.motion, self.seen = clock, motion, []

    def __call__(self, now):
        self.seen.append(now)
        t = self.clock.now() + 0.01
        q = self.motion(t)
        if q is None:
            return None
        qd = (self.motion(t + 1e-4) - self.motion(t - 1e-4)) / 2e-4
        return TrackingTarget(
            q=np.clip(q, LOWER, UPPER), qd=np.where(np.abs(q) > 1.0, 0.0, qd), limits=CAPS
        )


class Fence:
    """Nothing may get beyond an angle of the first joint."""

    def __init__(self, at):
        self.at = at

    def admits(self, way):
        return bool(np.all(way[:, 0] <= self.at))


def chase(sim, motion, watch=None):
    pursuit = Pursuit(
        Hare(sim.clock, motion),
        q_start=sim.state.q_ref,
        lower=LOWER,
        upper=UPPER,
        stop_limits=sim.executor.stop_limits(Channel.ARM),
        dt=sim.dt,
        watch=watch,
    )
    sim.executor.play(pursuit)
    return pursuit


def still(q):
    return lambda t: np.full(5, q)


def assert_bounded(sim, acceleration=8.0, jerk=200.0):
    qd = np.diff(sim.arm.goals, axis=0) / sim.dt
    qdd = np.diff(qd, axis=0) / sim.dt
    assert np.abs(qd).max() <= 2.0 * 1.001
    assert np.abs(qdd).max() <= acceleration * 1.01
    assert np.abs(np.diff(qdd, axis=0)).max() / sim.dt <= jerk * 1.01


def test_a_target_that_moves_steadily_is_caught_up_with_and_kept(sim):
    chase(sim, lambda t: np.full(5, 0.4 * t - 0.2))
    sim.clock.advance(1.5)
    wanted = 0.4 * (sim.arm.times[-1] + 0.01) - 0.2
    assert sim.arm.goals[-1] == pytest.approx(np.full(5, wanted), abs=1e-6)
    assert_bounded(sim)


def test_a_target_that_sways_is_followed_without_much_delay(sim):
    chase(sim, lambda t: np.full(5, 0.5 * np.sin(2.5 * t)))
    sim.clock.advance(4.0)
    wanted = 0.5 * np.sin(2.5 * (sim.arm.times[200:] + 0.01))
    assert np.abs(sim.arm.goals[200:, 0] - wanted).max() < 0.002
    assert_bounded(sim)


def test_a_target_that_jumps_about_is_never_followed_beyond_the_limits(sim):
    rng = np.random.default_rng(1)
    places = rng.uniform(-3.0, 3.0, (200, 5))
    chase(sim, lambda t: places[int(t / 0.05) % 200])
    sim.clock.advance(5.0)
    assert np.all(sim.arm.goals >= LOWER - 1e-4)
    assert np.all(sim.arm.goals <= UPPER + 1e-4)
    assert_bounded(sim)


def test_who_has_no_target_comes_to_rest_and_waits(sim):
    pursuit = chase(sim, lambda t: np.full(5, t) if t < 0.5 else None)
    sim.clock.advance(1.5)
    assert sim.state.mode is Mode.MOVING
    assert not pursuit.future.done()
    assert np.all(sim.state.qd_ref == 0.0)
    where = sim.state.q_ref
    sim.clock.advance(1.0)
    assert np.array_equal(sim.state.q_ref, where)
    assert_bounded(sim)


def test_it_begins_where_the_joints_are_wanted(sim):
    pursuit = chase(sim, still(0.3))
    sim.clock.advance(0.1)
    assert np.array_equal(pursuit.start.q, np.zeros(5))
    sim.after(1.0, sim.executor.stop())
    with pytest.raises(Interrupted, match="stop"):
        pursuit.future.result(timeout=0)


def test_closing_brings_the_joints_to_rest(sim):
    pursuit = chase(sim, lambda t: np.full(5, t))
    sim.clock.advance(0.4)
    sim.after(1.5, pursuit.close())
    assert sim.state.mode is Mode.HOLDING
    assert_bounded(sim)


def test_what_is_in_the_way_holds_the_joints_until_the_target_comes_back(sim):
    back = []
    pursuit = chase(sim, lambda t: np.full(5, 0.9 if not back else 0.1), Fence(0.5))
    sim.clock.advance(2.0)
    assert pursuit.is_held
    assert 0.3 < sim.state.q_ref[0] <= 0.5
    assert np.all(sim.state.qd_ref == 0.0)
    back.append(True)
    sim.clock.advance(2.0)
    assert not pursuit.is_held
    assert sim.state.q_ref == pytest.approx(np.full(5, 0.1), abs=1e-6)
    assert np.all(sim.arm.goals[:, 0] <= 0.5)
    assert_bounded(sim)


def test_joints_that_begin_outside_may_come_in_but_not_go_further_out(make_sim, taped_arm, clock):
    sim = make_sim(taped_arm(clock, q=np.full(5, 1.05)))
    sim.executor.start()
    chase(sim, lambda t: np.full(5, 2.0 if t < 0.5 else 0.0))
    sim.clock.advance(0.5)
    assert np.all(sim.arm.goals <= 1.05 + 1e-6)
    sim.clock.advance(2.0)
    assert sim.state.q_ref == pytest.approx(np.zeros(5), abs=1e-6)


def test_a_joint_that_is_held_fast_ends_it(sim):
    pursuit = chase(sim, lambda t: np.full(5, min(t, 0.8)))
    sim.clock.advance(0.2)
    sim.arm.jam("elbow_flex")
    error = sim.error_after(2.0, pursuit.future)
    assert isinstance(error, FollowingError)
    assert error.joint == "elbow_flex"


def test_two_motions_at_once_are_refused(sim):
    chase(sim, still(0.5))
    second = chase(sim, still(-0.5))
    error = sim.error_after(0.05, second.future)
    assert isinstance(error, MotionError)


def test_a_listener_is_told_every_period_until_it_has_enough(sim):
    heard = []
    end = sim.executor.listen(lambda state: heard.append(state.t))
    sim.clock.advance(1.0)
    assert np.diff(heard) == pytest.approx(np.full(len(heard) - 1, 0.01))
    assert len(heard) >= 100
    end()
    sim.clock.advance(0.2)
    count = len(heard)
    sim.clock.advance(1.0)
    assert len(heard) == count


def test_a_listener_that_fails_harms_nobody(sim, caplog):
    def fail(state):
        raise ValueError("oh")

    sim.executor.listen(fail)
    sim.clock.advance(0.05)
    assert "a listener failed" in caplog.text
    sim.after(3.0, sim.executor.execute(sim.to_goal(np.full(5, 0.2))))
