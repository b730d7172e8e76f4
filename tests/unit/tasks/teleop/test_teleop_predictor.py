import numpy as np
import pytest

from so101_motion.common.units import to_rad
from so101_motion.tasks.teleop.predictor import JUMP, LONGEST, Predictor

ALL = np.ones(6, dtype=bool)
TICK = to_rad(360.0 / 4096.0)


@pytest.fixture
def predictor():
    return Predictor()


def fed(predictor, motion, seconds, *, begin=0.0, dt=0.01, heard=ALL):
    """Feed ``motion(t)``, six numbers, rounded to ticks; the time of the last measurement."""
    t = begin
    for k in range(round(seconds / dt)):
        t = begin + k * dt
        predictor.take(t, np.round(motion(t) / TICK) * TICK, heard)
    return t


def test_nothing_is_known_before_a_measurement_of_all_joints_of_the_arm(predictor):
    assert predictor.at(1.0) is None
    heard = np.array([True, True, False, True, True, True])
    predictor.take(0.0, np.zeros(6), heard)
    assert predictor.at(0.0) is None
    predictor.take(0.01, np.zeros(6), np.array([True] * 5 + [False]))
    assert predictor.at(0.0) is not None


def test_a_reach_of_a_person_is_foretold_within_a_degree(predictor):
    def reach(t):
        u = min(max(t / 0.8, 0.0), 1.0)
        return np.full(6, to_rad(40.0) * u**3 * (10.0 - 15.0 * u + 6.0 * u**2))

    for k in range(100):
        t = 0.01 * k
        predictor.take(t, reach(t), ALL)
        if t > 0.1:
            x, _, _ = predictor.at(t + 0.03)
            assert np.degrees(np.abs(x - reach(t + 0.03))).max() < 1.5


def test_an_encoder_that_cannot_decide_is_not_taken_for_motion(predictor):
    rng = np.random.default_rng(0)
    t = fed(predictor, lambda t: TICK * rng.integers(0, 2, 6), 2.0)
    x, xd, _ = predictor.at(t + 0.05)
    assert np.abs(xd).max() < 0.01
    assert np.abs(x - 0.5 * TICK).max() < TICK


def test_nothing_is_foretold_from_an_old_measurement(predictor):
    t = fed(predictor, lambda t: np.full(6, t), 1.0)
    x, _, _ = predictor.at(t + 10.0)
    assert x == pytest.approx(np.full(6, t + LONGEST), abs=0.02)


def test_a_joint_that_does_not_answer_goes_on_as_it_went(predictor):
    t = fed(predictor, lambda t: np.full(6, t), 0.5)
    deaf = np.array([False, True, True, True, True, True])
    stuck = np.array([t, *[t + 0.01] * 5])
    predictor.take(t + 0.01, stuck, deaf)
    assert predictor.track.x[0] == pytest.approx(t + 0.01, abs=3.0 * TICK)
    assert predictor.track.t_heard == pytest.approx(t)
    predictor.take(t + 0.02, np.full(6, t + 0.02), ALL)
    assert predictor.track.t_heard == pytest.approx(t + 0.02)


def test_a_leader_that_is_suddenly_elsewhere_is_reported_and_taken_as_it_is(predictor):
    t = fed(predictor, lambda t: np.zeros(6), 0.5)
    far = np.array([0.0, 1.1 * JUMP, 0.0, 0.0, 0.0, 0.0])
    predictor.take(t + 0.01, far, ALL)
    assert predictor.track.jumps == 1
    assert predictor.track.x == pytest.approx(far)
    assert np.all(predictor.track.xd == 0.0)
    predictor.take(t + 0.02, far, ALL)
    assert predictor.track.jumps == 1


def test_a_long_silence_counts_as_being_elsewhere(predictor):
    t = fed(predictor, lambda t: np.zeros(6), 0.5)
    predictor.take(t + LONGEST + 0.01, np.zeros(6), ALL)
    assert predictor.track.jumps == 1


def test_a_leader_known_to_be_lost_has_not_been_heard(predictor):
    predictor.lose()
    t = fed(predictor, lambda t: np.full(6, t), 0.5)
    predictor.lose()
    assert predictor.track.t_heard == -np.inf
    predictor.take(t + 0.05, np.full(6, t + 0.05), ALL)
    assert predictor.track.t_heard == pytest.approx(t + 0.05)
    assert predictor.track.jumps == 0


def test_a_leader_that_is_asked_five_times_a_second_is_not_elsewhere_each_time():
    predictor = Predictor(longest=0.75)
    t = fed(predictor, lambda t: np.full(6, 1.5 * np.sin(1.5 * t)), 4.0, dt=0.2)
    assert predictor.track.jumps == 0
    assert predictor.track.x[0] == pytest.approx(1.5 * np.sin(1.5 * t), abs=0.1)


def test_the_same_measurement_again_is_ignored(predictor):
    t = fed(predictor, lambda t: np.full(6, t), 0.5)
    before = predictor.track
    predictor.take(t, np.full(6, 9.0), ALL)
    assert predictor.track is before
    predictor.reset()
    assert predictor.at(t) is None


def test_what_rests_stays_where_it_is_until_it_leaves_it(predictor):
    t = fed(predictor, lambda t: np.full(6, 0.2), 0.5)
    x, xd, xdd = predictor.at(t + 0.03)
    assert not xd.any()
    assert not xdd.any()
    assert x == pytest.approx(np.full(6, 0.2), abs=TICK)
    t = fed(predictor, lambda t: np.full(6, 0.2 + 0.3 * (t - 0.5)), 0.2, begin=0.5)
    assert predictor.at(t)[1] == pytest.approx(np.full(6, 0.3), abs=0.1)
