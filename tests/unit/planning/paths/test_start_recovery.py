import numpy as np

from so101_motion.planning.paths.start_recovery import find_departure, is_harmless, needs_departure

# How a powered-off arm lies: beyond two limits, gripper on the shoulder.
RESTING = np.radians([0, -105, 91, 77, 0])


def departure(model, collision, q_start, towards=()):
    return find_departure(model, collision, q_start, q_jaw=0.0, towards=towards, seed=0)


def test_one_tick_outside_is_noise(model, collision):
    assert not needs_departure(model, collision, np.zeros(5), 0.0)
    q = np.zeros(5)
    q[0] = model.upper[0] + 0.0015
    assert not needs_departure(model, collision, q, 0.0)
    q[0] = model.upper[0] + 0.0016
    assert needs_departure(model, collision, q, 0.0)


def test_an_arm_that_lies_folded_can_leave(model, collision):
    assert needs_departure(model, collision, RESTING, 0.0)
    q_exit = departure(model, collision, RESTING)
    assert model.outside(q_exit) is None
    assert collision.is_free(q_exit)
    assert collision.travel(np.array([RESTING, q_exit]))[-1] < 0.4
    depths = [collision.distances(q) for q in np.linspace(RESTING, q_exit, 100)]
    deepest = np.min(depths, axis=0)
    allowed = np.minimum(depths[0], collision.margin) - 0.001
    assert np.all(deepest >= allowed)


def test_a_start_outside_the_limits_goes_straight_in(model, collision):
    q_start = np.radians([0, -104, 0, 0, 0])
    q_exit = departure(model, collision, q_start)
    assert np.array_equal(q_exit, np.clip(q_start, model.lower, model.upper))


def test_the_way_out_leans_towards_the_goal_if_it_can(model, collision):
    # Just too close to the floor; the goal is straight above.
    q_start = np.radians([0, 20, -10, 78.0, 0])
    while collision.is_free(q_start):
        q_start[1] += 0.002
    goal = q_start - [0.0, 0.5, 0.0, 0.0, 0.0]
    q_exit = departure(model, collision, q_start, [goal])
    assert collision.is_free(q_exit)
    assert is_harmless(collision, np.array([q_start, q_exit]), 0.0)


def test_a_motion_into_contact_is_not_harmless(collision):
    down = np.array([np.zeros(5), np.radians([0, 60, 20, 40, 0])])
    assert not is_harmless(collision, down, 0.0)
    assert is_harmless(collision, down[[0, 0]], 0.0)
