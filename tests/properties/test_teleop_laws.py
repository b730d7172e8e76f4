"""Laws of following: whatever the leader does, limits are kept and nothing jumps."""

import numpy as np
import pytest
from harness.setpoints import shares
from hypothesis import given, settings
from hypothesis import strategies as st

from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import ConfigError
from so101_motion.control.following import EASE, GATE, Following
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.pursuit import Pursuit
from so101_motion.planning.timing.trajectory import Setpoint
from so101_motion.tasks.teleop.pilot import LOST_AFTER, Mirror, Pace, Phase, Pilot
from so101_motion.tasks.teleop.predictor import Predictor

DT = 0.01
LOWER, UPPER = np.full(5, -1.6), np.full(5, 1.7)
STOP = MotionLimits.uniform(velocity=np.pi, acceleration=10.5, jerk=200.0)
PACE = Pace()
HIGHEST = MotionLimits.uniform(velocity=np.pi, acceleration=10.5, jerk=500.0)

angles = st.lists(st.floats(-4.0, 4.0), min_size=5, max_size=5).map(np.array)
rates = st.lists(st.floats(-9.0, 9.0), min_size=5, max_size=5).map(np.array)
inside = st.lists(st.floats(-1.5, 1.5), min_size=5, max_size=5).map(np.array)
caps = st.builds(
    lambda v, a, j: MotionLimits.uniform(velocity=v, acceleration=a, jerk=j),
    st.floats(0.1, 3.0),
    st.floats(0.5, 10.0),
    st.floats(5.0, 500.0),
)
wild = st.lists(st.floats(), min_size=5, max_size=5).map(np.array)
wishes = st.one_of(st.none(), st.tuples(angles, rates), st.tuples(wild, rates))


def following(q_start, limits, **settings):
    more = {"lower": LOWER, "upper": UPPER, "stop_limits": STOP, "dt": DT}
    return Following(q_start=q_start, limits=limits, **more, **settings)


@settings(max_examples=25)
@given(
    q_start=inside,
    limits=caps,
    approach=st.none() | caps,
    plan=st.lists(st.tuples(wishes, st.integers(1, 30)), max_size=8),
)
def test_a_following_never_leaves_its_range_nor_breaks_a_cap_whatever_the_target_does(
    q_start, limits, approach, plan
):
    motion = following(q_start, limits, approach=approach)
    steps = [q_start, q_start]
    for asked, ticks in plan:
        for _ in range(ticks):
            if asked is not None and np.isfinite(asked).all():
                motion.aim(*asked, most=np.inf)
            elif asked is not None:
                with pytest.raises(ConfigError):
                    motion.aim(*asked, most=np.inf)
            steps.append(motion.sample(0).q)
    motion.close()
    steps += [motion.sample(0).q for _ in range(120)]
    assert motion.is_over
    steps = np.array(steps)
    assert np.all(steps >= np.minimum(LOWER, q_start) - 5e-4)
    assert np.all(steps <= np.maximum(UPPER, q_start) + 5e-4)
    assert max(shares(steps, DT, HIGHEST)) <= 1.01


@given(
    q=inside, qd=inside, target=inside, rate=st.lists(st.floats(-1.0, 1.0), min_size=5, max_size=5)
)
@settings(max_examples=10)
def test_a_steady_target_is_caught_and_kept_exactly(q, qd, target, rate):
    limits = MotionLimits.uniform(velocity=3.0, acceleration=8.0, jerk=300.0)
    now, rate = Setpoint(q=q, qd=qd, qdd=np.zeros(5)), np.array(rate)
    pursuit = Pursuit(5, DT)
    for k in range(1, 700):
        now = pursuit.towards(now, target + k * DT * rate, rate, limits)
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


@settings(max_examples=25)
@given(script=moves, q_start=inside)
def test_a_follower_never_steps_and_sets_off_only_near_its_leader(script, q_start):
    clock, predictor = ManualClock(), Predictor()
    pilot = Pilot(clock, predictor, Mirror(), PACE)
    pilot.fit(LOWER, UPPER)

    def each(motion):
        wanted = pilot.arm(motion.now.q)
        if wanted is None:
            motion.hold(briefly=pilot.gate.pauses_mirroring)
        else:
            motion.aim(*wanted)

    pursuit = following(q_start, PACE.full, approach=PACE.approach, each=each)
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
            before, is_paused = steps[-1], pilot.gate.is_paused
            steps.append(pursuit.sample(0).q)
            phase = pilot.gate.phase
            if silent_since is not None and clock.now() - silent_since > LOST_AFTER + DT:
                assert phase is Phase.WAITING
            if phase is Phase.MIRRORING and phases[-1] is Phase.WAITING and not is_paused:
                assert pilot.gate.gap[1] <= GATE + 1e-9
                assert np.abs(steps[-1] - before).max() <= PACE.approach.velocity[0] * DT * 1.001
            phases.append(phase)
            clock.advance(DT)
    steps = np.array(steps)
    assert max(shares(steps, DT, HIGHEST)) <= 1.01
    approaching = [i for i, phase in enumerate(phases) if phase is Phase.APPROACHING]
    speeds = np.abs(np.diff(steps[1:], axis=0)).max(axis=1) / DT
    assert all(speeds[i - 1] <= PACE.approach.velocity[0] * 1.001 for i in approaching if i > 0)
    assert EASE > 0.0
