"""The arm as a robot of LeRobot: what its commands call, on emulated servos."""

import math
import os
import signal

import numpy as np
import pytest
from harness.lerobot_bench import READY, action
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_robot_so101_motion.config import SO101MotionConfig
from so101_motion.drivers.emulator import registers as reg
from so101_motion.planning.collision.collision import CollisionModel


def values(robot):
    return np.array([robot.get_observation()[key] for key in robot.action_features])


def test_features_are_known_before_it_is_connected(bench):
    robot = bench.robot()
    assert list(robot.action_features) == list(action(*READY))
    assert robot.observation_features == robot.action_features
    assert not robot.is_connected
    with pytest.raises(DeviceNotConnectedError):
        robot.get_observation()


def test_a_first_target_that_is_far_is_approached_by_a_plan(folded):
    bench = folded
    robot = bench.robot()
    robot.connect(calibrate=False)
    begin = bench.clock.now()
    taken = robot.send_action(action(*READY))
    assert taken == pytest.approx(action(*READY))
    assert bench.clock.now() - begin > 52.0 / 30.0  # the shoulder's way, at 30 deg/s
    bench.advance(0.6)
    assert np.abs(values(robot) - READY)[:5].max() < 0.5


def test_a_target_is_taken_up_in_the_next_control_cycle(bench):
    robot = bench.connected()
    rig = bench.open()
    for k in range(50):  # past the time in which the pace rises
        robot.send_action(action(0.1 * k, *READY[1:]))
        bench.advance(0.01)
    before = rig.arm.state.q_ref[1]
    robot.send_action(action(5.0, -30.0, *READY[2:]))
    bench.advance(0.0101)
    assert rig.arm.state.q_ref[1] > before


def test_observations_are_fresh_and_lerobots_own_formula_of_the_servos_positions(bench):
    robot = bench.connected(20.0, -30.0, 30.0, 50.0, -40.0, 60.0)
    for joint, value in robot.get_observation().items():
        servo = bench.world.servo(joint.removesuffix(".pos"))
        low, high = servo.memory.value(reg.MIN_POSITION), servo.memory.value(reg.MAX_POSITION)
        ticks = servo.drive.position
        expected = (ticks - (low + high) / 2.0) * 360.0 / 4095.0
        if joint == "gripper.pos":
            expected = 100.0 * (ticks - low) / (high - low)
        assert value == pytest.approx(expected, abs=0.15)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, None, "far"])
def test_a_target_that_is_no_number_is_not_taken_and_the_log_says_so(bench, caplog, wrong):
    robot = bench.connected()
    taken = robot.send_action(action(wrong, *READY[1:]))
    assert taken == pytest.approx(action(*READY))
    assert "shoulder_pan.pos" in caplog.text
    bench.advance(1.0)
    assert np.abs(values(robot) - READY)[:5].max() < 0.5


def test_joints_that_are_left_out_keep_their_targets_and_others_are_refused(bench):
    robot = bench.connected()
    taken = robot.send_action({"shoulder_pan.pos": 3.0, "task": "wave"})
    assert taken == pytest.approx(action(3.0, *READY[1:]))
    with pytest.raises(ValueError, match=r"thumb\.pos is not a joint"):
        robot.send_action({"thumb.pos": 3.0})


def test_what_was_taken_of_a_target_beyond_the_range_is_returned_logged_and_observed(bench, caplog):
    robot = bench.connected(record_taken=True)
    taken = robot.send_action(action(5000.0, *READY[1:]))
    assert 90.0 < taken["shoulder_pan.pos"] < 130.0
    assert "5000.0 was limited to" in caplog.text
    seen = robot.get_observation()
    assert list(seen) == list(robot.observation_features)
    assert seen["shoulder_pan.taken"] == pytest.approx(taken["shoulder_pan.pos"])
    assert seen["elbow_flex.taken"] == pytest.approx(READY[2])


def test_targets_keep_within_max_relative_target_and_what_is_none_is_refused(bench):
    robot = bench.connected(max_relative_target={"shoulder_pan": 4.0})
    taken = robot.send_action(action(30.0, *READY[1:]))
    assert taken["shoulder_pan.pos"] == pytest.approx(4.0, abs=0.5)
    for most in ({"pan": 4.0}, {"shoulder_pan": -1.0}, -5.0, 0.0, math.nan):
        with pytest.raises(ValueError, match="max_relative_target"):
            SO101MotionConfig(port="none", max_relative_target=most)


def test_a_target_in_the_table_holds_the_arm_off_it(bench):
    robot = bench.connected()
    rig = bench.open()
    collision, nearest = CollisionModel(rig.arm.model), math.inf
    for _ in range(150):
        robot.send_action(action(0.0, 60.0, -20.0, 60.0, 0.0, 30.0))
        bench.advance(0.02)
        nearest = min(nearest, float(collision.distances(rig.arm.state.q, 0.0).min()))
    assert nearest > 0.0


def test_without_targets_the_arm_slows_to_rest(bench):
    robot = bench.connected()
    rig = bench.open()
    robot.send_action(action(80.0, *READY[1:]))
    bench.advance(0.15)
    assert np.abs(rig.arm.state.qd_ref).max() > 0.1
    bench.advance(0.6)
    assert not rig.arm.state.qd_ref.any()
    assert math.degrees(rig.arm.state.q_ref[0]) < 60.0


def test_an_arm_that_is_left_in_motion_comes_to_rest_and_goes_on_holding(bench, caplog):
    robot = bench.connected()
    robot.send_action(action(80.0, *READY[1:]))
    bench.advance(0.2)
    robot.disconnect()
    assert "goes on holding" in caplog.text
    assert not robot.is_connected
    here = bench.q_deg.copy()
    bench.advance(3.0)
    assert np.abs(bench.q_deg - here).max() < 1.5
    with pytest.raises(DeviceNotConnectedError):
        robot.disconnect()


@pytest.mark.parametrize("let_go", [True, False])
def test_an_arm_with_a_park_pose_goes_there_and_is_let_go_of_if_that_is_asked(bench, let_go):
    robot = bench.connected(park="rest", disable_torque_on_disconnect=let_go)
    robot.disconnect()
    assert bool(bench.world.servo("shoulder_lift").drive.torque) is not let_go
    here = bench.q_deg.copy()
    bench.advance(3.0)
    assert np.abs(bench.q_deg - here).max() < 8.0  # the forearm comes to lie on its stop


def test_without_a_file_it_goes_by_what_the_servos_remember_and_says_so(bench, caplog):
    robot = bench.robot()
    robot.connect(calibrate=False)
    assert not robot.is_calibrated
    assert "the values in its servos are used" in caplog.text
    with pytest.raises(DeviceAlreadyConnectedError):
        robot.connect()


def test_an_unplugged_cable_is_an_error_and_nothing_hangs(bench):
    robot = bench.connected()
    bench.emulator.unplug()
    for _ in range(100):
        try:
            robot.send_action(action(10.0, *READY[1:]))
        except ConnectionError:
            break
        bench.advance(0.02)
    with pytest.raises(ConnectionError, match=str(bench.port)):
        robot.get_observation()
    robot.disconnect()
    assert not robot.is_connected
    bench.emulator.plug()


def test_an_arm_that_meets_something_waits_for_a_target_near_where_it_holds(bench, caplog):
    robot = bench.connected()
    rig = bench.open()
    shaft = bench.world.servo("shoulder_pan").drive.shaft  # between two things that do not yield
    shaft.lower, shaft.upper = shaft.output - 3.0, shaft.output + 3.0
    for _ in range(100):
        taken = robot.send_action(action(40.0, *READY[1:]))
        bench.advance(0.02)
    assert "The arm holds until a target" in caplog.text
    assert taken["shoulder_pan.pos"] < 15.0
    assert not rig.arm.state.qd_ref.any()
    assert robot.send_action(action(0.5, *READY[1:]))["shoulder_pan.pos"] == pytest.approx(0.5)


def lifted(bench, **settings):
    """How far the elbow ends from where it is sent, after it has lifted the forearm [deg]."""
    robot = bench.connected(**settings)
    for k in range(120):
        elbow = 40.0 - min(0.25 * k, 15.0)
        robot.send_action(action(*READY[:2], elbow, *READY[3:]))
        bench.advance(0.02)
    off = robot.get_observation()["elbow_flex.pos"] - 25.0
    robot.disconnect()
    return off


def test_with_stock_droop_a_lifted_forearm_stays_below_where_it_is_sent(bench):
    assert abs(lifted(bench)) < 0.4
    assert 0.6 < lifted(bench, stock_droop=True) < 6.0


def test_sigterm_ends_the_program_in_order_while_an_arm_is_connected(bench):
    robot = bench.connected()
    with pytest.raises(SystemExit):
        os.kill(os.getpid(), signal.SIGTERM)
    robot.disconnect()
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
