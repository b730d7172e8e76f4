"""Laws of following: whatever the leader does, limits are kept and nothing jumps."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from so101_motion.common.clock import ManualClock
from so101_motion.control.target_tracking import Pursuit, TrackingTarget
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Setpoint
from so101_motion.tasks.teleop.gate import EASE, GATE, Phase
from so101_motion.tasks.teleop.mirror import Mirror
from so101_motion.tasks.teleop.pilot import LOST_AFTER, Pace, Pilot
from so101_motion.tasks.teleop.predictor import Predictor

DT = 0.01
LOWER, UPPER = np.full(5, -1.6), np.full(5, 1.7)
STOP = MotionLimits.uniform(velocity=np.pi, acceleration=10.5, jerk=200.0)
PACE = Pace()

angles = st.lists(st.floats(-4.0, 4.0), min_size=5, max_size=5).map(np.array)
rates = st.lists(st.floats(-9.0, 9.0), min_size=5, max_size=5).map(np.array)
inside = st.lists(st.floats(-1.5, 1.5), min_size=5, max_size=5).map(np.array)
caps = st.builds(
    lambda v, a, j: MotionLimits.uniform(velocity=v, acceleration=a, jerk=j),
    st.floats(0.1, 3.0),
    st.floats(0.5, 10.0),
    st.floats(5.0, 500.0),
)
wishes = st.one_of(st.none(), st.tuples(angles, rates, caps))


def bounded(steps, *, velocity, acceleration, jerk):
    """That setpoints, shape (n, 5), keep these caps by finite differences."""
    qd = np.diff(steps, axis=0) / DT
    qdd = np.diff(qd, axis=0) / DT
    assert np.abs(qd).max(initial=0.0) <= velocity * 1.001 + 1e-9
    assert np.abs(qdd).max(initial=0.0) <= acceleration * 1.01 + 1e-6
    assert np.abs(np.diff(qdd, axis=0)).max(initial=0.0) / DT <= jerk * 1.01 + 1e-3


@given(q_start=inside, plan=st.lists(st.tuples(wishes, st.integers(1, 30)), max_size=8))
def test_a_pursuit_never_leaves_its_range_nor_breaks_a_cap_whatever_the_target_does(q_start, plan):
    wish = None
    pursuit = Pursuit(
        lambda _: None if wish is None else TrackingTarget(q=wish[0], qd=wish[1], limits=wish[2]),
        q_start=q_start,
        lower=LOWER,
        upper=UPPER,
        stop_limits=STOP,
        dt=DT,
    )
    steps = [q_start, q_start]
    for asked, ticks in plan:
        if asked is not None:
            asked = (np.clip(asked[0], LOWER, UPPER), asked[1], asked[2])
        wish = asked
        steps += [pursuit.sample(0).q for _ in range(ticks)]
    pursuit.close()
    for _ in range(120):
        steps.append(pursuit.sample(0).q)
    assert pursuit.is_over
    steps = np.array(steps)
    assert np.all(steps >= np.minimum(LOWER, q_start) - 5e-4)
    assert np.all(steps <= np.maximum(UPPER, q_start) + 5e-4)
    bounded(steps, velocity=np.pi, acceleration=10.5, jerk=500.0)


@given(
    q_start=inside,
    goals=st.lists(angles, min_size=1, max_size=5),
    fence=st.floats(-1.5, 1.5),
)
def test_what_is_watched_is_never_passed(q_start, goals, fence):
    class Fence:
        def admits(self, way):
            return bool(np.all(way[:, 0] <= max(fence, q_start[0])))

    at = goals[0]
    pursuit = Pursuit(
        lambda _: TrackingTarget(q=np.clip(at, LOWER, UPPER), qd=np.zeros(5), limits=PACE.full),
        q_start=q_start,
        lower=LOWER,
        upper=UPPER,
        stop_limits=STOP,
        dt=DT,
        watch=Fence(),
    )
    steps = []
    for goal in goals:
        at = goal
        steps += [pursuit.sample(0).q for _ in range(60)]
    pursuit.close()
    steps += [pursuit.sample(0).q for _ in range(60)]
    assert np.all(np.array(steps)[:, 0] <= max(fence, q_start[0]) + 5e-4)


@given(
    q=inside, qd=inside, target=inside, rate=st.lists(st.floats(-1.0, 1.0), min_size=5, max_size=5)
)
@settings(max_examples=50)
def test_a_steady_target_is_caught_and_kept_exactly(q, qd, target, rate):
    limits = MotionLimits.uniform(velocity=3.0, acceleration=8.0, jerk=300.0)
    now, rate = Setpoint(q=q, qd=qd, qdd=np.zeros(5)), np.array(rate)
    for k in range(1, 700):
        now = online.towards(now, target + k * DT * rate, rate, limits, DT)
    assert np.abs(now.q - target - 699 * DT * rate).max() < 1e-6
    assert np.abs(now.qd - rate).max() < 1e-6


# The whole of it, but for the wire

moves = st.lists(
    st.tuples(
        st.sampled_from(["lead", "lead", "lead", "silence", "elsewhere"]),
        st.lists(st.floats(-2.5, 2.5), min_size=5, max_size=5),
        st.integers(5, 60),
    ),
    min_size=1,
    max_size=6,
)


@given(script=moves, q_start=inside)
def test_a_follower_never_steps_and_sets_off_only_near_its_leader(script, q_start):
    clock, predictor = ManualClock(), Predictor()
    pilot = Pilot(clock, predictor, Mirror(), PACE)
    pilot.fit(LOWER, UPPER, lambda limits: limits)
    pursuit = Pursuit(pilot.arm, q_start=q_start, lower=LOWER, upper=UPPER, stop_limits=STOP, dt=DT)
    heard, leader = np.ones(6, dtype=bool), np.zeros(6)
    predictor.take(0.0, leader, heard)
    clock.advance(DT)
    pilot.begin()
    steps, phases = [q_start, q_start], [Phase.APPROACHING]
    silent_since = None
    for kind, goal, ticks in script:
        if kind == "elsewhere":
            leader[:5] = goal
        begin, silent_since = leader[:5].copy(), None
        for k in range(ticks):
            if kind == "lead":
                leader[:5] = begin + (np.array(goal) - begin) * (k + 1) / ticks
            if kind != "silence":
                predictor.take(clock.now(), leader, heard)
                silent_since = None
            elif silent_since is None:
                silent_since = clock.now() - DT
            before = steps[-1]
            steps.append(pursuit.sample(0).q)
            phase = pilot.gate.phase
            if silent_since is not None and clock.now() - silent_since > LOST_AFTER + DT:
                assert phase is Phase.WAITING
            if phase is Phase.MIRRORING and phases[-1] is Phase.WAITING:
                assert pilot.gate.gap[1] <= GATE + 1e-9
                assert np.abs(steps[-1] - before).max() <= PACE.approach.velocity[0] * DT * 1.001
            phases.append(phase)
            clock.advance(DT)
    steps = np.array(steps)
    bounded(steps, velocity=np.pi, acceleration=10.5, jerk=500.0)
    approaching = [i for i, phase in enumerate(phases) if phase is Phase.APPROACHING]
    speeds = np.abs(np.diff(steps[1:], axis=0)).max(axis=1) / DT
    assert all(speeds[i - 1] <= PACE.approach.velocity[0] * 1.001 for i in approaching if i > 0)
    assert EASE > 0.0
