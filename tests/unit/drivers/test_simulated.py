import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import CommandRefused
from so101_motion.drivers.simulated import MAX_SPEED, SimArm

Q = np.array([0.3, -0.5, 0.8, 0.2, -1.0])


@pytest.fixture
def arm(clock):
    arm = SimArm(clock)
    arm.set_torque(True)
    return arm


def set_off(arm, q, q_jaw=0.0):
    """Give the joints a goal that is far away, as only limp ones may be given."""
    arm.set_torque(False)
    arm.write(np.array(q), q_jaw)
    arm.set_torque(True)


def test_joints_come_to_the_goal_and_rest_there(clock, arm):
    set_off(arm, Q, 0.4)
    clock.advance(1.0)
    reading = arm.read()
    np.testing.assert_allclose(reading.q, Q, atol=1e-9)
    np.testing.assert_allclose(reading.qd, 0.0, atol=1e-9)
    assert reading.q_jaw == pytest.approx(0.4, abs=1e-9)


def test_a_joint_never_overshoots_and_never_exceeds_its_speed(clock, arm):
    set_off(arm, Q, 0.4)
    seen = []
    for _ in range(1000):
        clock.advance(0.001)
        seen.append(arm.read())
    q, qd = np.array([r.q for r in seen]), np.array([r.qd for r in seen])
    assert np.all(np.diff(q * np.sign(Q), axis=0) >= -1e-12)
    assert np.max(np.abs(qd)) <= MAX_SPEED
    assert np.max(np.abs(qd)) > 0.95 * MAX_SPEED


@given(
    goals=st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=4),
    cuts=st.lists(st.floats(1e-4, 0.3), min_size=1, max_size=20),
)
def test_motion_does_not_depend_on_how_often_it_is_looked_at(goals, cuts):
    clock = ManualClock()
    watched, alone = SimArm(clock), SimArm(clock)
    for arm in (watched, alone):
        arm.set_torque(True)
    for goal in goals:
        for arm in (watched, alone):
            set_off(arm, np.full(5, goal), goal / 2.0)
        for cut in cuts:
            clock.advance(cut)
            watched.read()
    one, other = watched.read(), alone.read()
    np.testing.assert_allclose(one.q, other.q, atol=1e-9)
    np.testing.assert_allclose(one.qd, other.qd, atol=1e-7)
    assert one.q_jaw == pytest.approx(other.q_jaw, abs=1e-9)


def test_limp_joints_stay_where_they_are_pushed(clock):
    arm = SimArm(clock, q=Q, q_jaw=0.2)
    arm.push(np.zeros(5), 0.5)
    clock.advance(10.0)
    np.testing.assert_array_equal(arm.read().q, np.zeros(5))
    assert arm.read().q_jaw == 0.5
    assert not arm.torque


def test_switching_on_drives_to_the_goal_that_was_written_last(clock, arm):
    with pytest.raises(RuntimeError, match="driven"):
        arm.push(np.zeros(5))
    set_off(arm, Q)
    clock.advance(1.0)
    arm.set_torque(False)
    arm.push(np.zeros(5))
    arm.set_torque(True)
    clock.advance(2.0)
    np.testing.assert_allclose(arm.read().q, Q, atol=1e-9)


def test_switching_off_stops_a_joint_dead(clock, arm):
    set_off(arm, Q)
    clock.advance(0.1)
    arm.set_torque(False)
    here = arm.read()
    np.testing.assert_array_equal(here.qd, np.zeros(5))
    clock.advance(1.0)
    np.testing.assert_array_equal(arm.read().q, here.q)


def test_a_jammed_joint_stays_and_the_others_go_on(clock, arm):
    arm.jam("elbow_flex")
    set_off(arm, Q, 0.4)
    clock.advance(1.0)
    reading = arm.read()
    assert reading.q[2] == reading.qd[2] == 0.0
    np.testing.assert_allclose(np.delete(reading.q, 2), np.delete(Q, 2), atol=1e-9)
    arm.unjam("elbow_flex")
    clock.advance(0.001)
    assert abs(arm.read().qd[2]) <= MAX_SPEED
    clock.advance(1.0)
    assert arm.read().q[2] == pytest.approx(Q[2], abs=1e-9)


def test_a_broken_connection_raises_and_the_joints_go_on(clock, arm):
    set_off(arm, Q)
    arm.disconnect(OSError("unplugged"))
    for exchange in (arm.read, lambda: arm.write(Q, 0.0), lambda: arm.set_torque(True)):
        with pytest.raises(OSError, match="unplugged"):
            exchange()
    clock.advance(1.0)
    arm.reconnect()
    np.testing.assert_allclose(arm.read().q, Q, atol=1e-9)


def test_driven_joints_refuse_a_goal_that_is_further_away_than_their_caps_allow(clock, arm):
    clock.advance(0.01)
    with pytest.raises(CommandRefused, match="shoulder_pan"):
        arm.write(Q, 0.4)
    clock.advance(1.0)
    np.testing.assert_array_equal(arm.read().q, np.zeros(5))


def test_a_simulated_arm_shows_its_commands_too(clock):
    seen = []
    arm = SimArm(clock)
    arm.on_command = seen.append
    arm.write(np.zeros(5), 0.1)
    arm.set_torque(True)
    clock.advance(0.01)
    arm.write(np.full(5, 0.002), 0.1)
    assert [(one.t, one.q_cmd, one.q_jaw_cmd, one.is_seed) for one in seen] == [
        (0.0, (0.0,) * 5, 0.1, True),
        (0.01, (0.002,) * 5, 0.1, False),
    ]
