"""Keys and gamepads as a teleoperator of LeRobot, leading the tool of an emulated arm."""

import os
import pty
import struct
import sys

import numpy as np
import pytest
from harness.lerobot_bench import READY, SO101MotionJog, SO101MotionJogConfig, lerobot_bench
from lerobot.utils.errors import DeviceNotConnectedError

from so101_motion.common.named_poses import POSES

AXIS, BUTTON = 2, 1


@pytest.fixture
def pad(tmp_path):
    """Says what a gamepad would."""
    path = tmp_path / "js0"
    os.mkfifo(path)
    end = os.open(path, os.O_RDWR)

    def say(*events):
        for kind, number, value in events:
            os.write(end, struct.pack("=IhBB", 0, value, kind, number))

    yield path, say
    os.close(end)


@pytest.fixture
def jog(pad, tmp_path):
    jog = SO101MotionJog(SO101MotionJogConfig(device=str(pad[0]), calibration_dir=tmp_path))
    jog.connect()
    yield jog
    if jog.is_connected:
        jog.disconnect()


def lead(bench, robot, jog, seconds):
    for _ in range(round(30.0 * seconds)):
        robot.send_action(jog.get_action())
        bench.advance(1.0 / 30.0)


def tool(bench):
    return bench.rig.arm.model.frame(bench.rig.arm.state.q_ref).p


def test_a_held_stick_leads_the_tool_along_a_straight_line_until_it_is_let_go(bench, pad, jog):
    robot, say = bench.connected(), pad[1]
    start = tool(bench)
    say((BUTTON, 5, 1), (AXIS, 4, -32767))  # the right stick, upwards
    lead(bench, robot, jog, 1.0)
    say((BUTTON, 5, 0))
    lead(bench, robot, jog, 0.7)
    way = 1000.0 * (tool(bench) - start)
    assert 30.0 < way[2] < 48.0
    assert np.abs(way[:2]).max() < 0.5
    assert not bench.rig.arm.state.qd_ref.any()


def test_an_arm_that_lies_close_to_itself_and_to_the_table_is_jogged_away_from_rest(tmp_path):
    rest = next(pose.q for pose in POSES if pose.name == "rest")
    lying = rest + np.radians((0.0, 0.0, 10.0, 0.0, 0.0))
    aside = np.array((0.0, 0.1, -1.15, 0.95, 0.02, 0.0))  # up, on a straight line of the tool
    with lerobot_bench(tmp_path, q_start=(*lying, 0.0)) as bench:
        robot = bench.robot()
        robot.connect(calibrate=False)
        names = robot.action_features
        start = np.array([robot.get_observation()[name] for name in names])
        q = bench.rig.arm.state.q_ref
        for _ in range(30):
            robot.send_action(dict(zip(names, start + aside, strict=True)))
            bench.advance(1.0 / 30.0)
        moved = np.degrees(bench.rig.arm.state.q_ref - q)
        assert moved[2] < -0.8
        assert moved[3] > 0.5


def test_a_stick_without_a_shoulder_button_moves_nothing(bench, pad, jog):
    robot = bench.connected()
    start = tool(bench)
    pad[1]((AXIS, 4, -32767), (AXIS, 1, 32767), (AXIS, 5, 32767))
    lead(bench, robot, jog, 0.5)
    assert np.abs(tool(bench) - start).max() < 1e-6


def test_triggers_open_and_close_the_jaw(bench, pad, jog):
    robot, say = bench.connected(), pad[1]
    say((BUTTON, 4, 1), (AXIS, 5, 32767))
    lead(bench, robot, jog, 0.5)
    say((BUTTON, 4, 0))
    lead(bench, robot, jog, 0.5)
    assert robot.get_observation()["gripper.pos"] == pytest.approx(READY[5] + 30.0, abs=3.0)


def test_a_jog_after_the_arm_was_moved_begins_where_it_is(bench, pad, jog):
    robot, say = bench.connected(), pad[1]
    lead(bench, robot, jog, 0.1)
    elsewhere = np.add(READY, (10.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    for _ in range(45):
        robot.send_action(dict(zip(robot.action_features, elsewhere, strict=True)))
        bench.advance(1.0 / 30.0)
    say((BUTTON, 5, 1), (AXIS, 4, -32767))
    first = jog.get_action()
    assert first["shoulder_pan.pos"] == pytest.approx(10.0, abs=0.2)


def test_an_arm_that_does_not_follow_is_not_run_away_from_and_goes_on_when_held_anew(
    bench, pad, jog
):
    robot, say = bench.connected(), pad[1]
    shaft = bench.world.servo("shoulder_pan").drive.shaft  # between two things that do not yield
    lower, upper = shaft.lower, shaft.upper
    shaft.lower, shaft.upper = shaft.output - 3.0, shaft.output + 3.0
    say((BUTTON, 5, 1), (AXIS, 0, -32767))
    lead(bench, robot, jog, 3.0)
    assert abs(jog.get_action()["shoulder_pan.pos"]) < 20.0
    say((BUTTON, 5, 0))
    lead(bench, robot, jog, 0.3)
    shaft.lower, shaft.upper = lower, upper
    say((BUTTON, 5, 1))
    start = tool(bench)
    lead(bench, robot, jog, 1.5)
    assert np.abs(tool(bench) - start).max() > 0.02


def test_without_an_arm_and_without_a_device_it_says_what_to_do(jog, tmp_path):
    with pytest.raises(DeviceNotConnectedError, match="connected; use --robot"):
        jog.get_action()
    missing = SO101MotionJogConfig(device=str(tmp_path / "js7"), calibration_dir=tmp_path)
    with pytest.raises(ConnectionError, match="js7"):
        SO101MotionJog(missing).connect()


def test_a_key_leads_while_the_terminal_repeats_it_and_is_let_go_soon_after(
    bench, tmp_path, monkeypatch
):
    ours, theirs = pty.openpty()
    with open(theirs) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        jog = SO101MotionJog(SO101MotionJogConfig(calibration_dir=tmp_path))
        jog.connect()
        robot, start = bench.connected(), tool(bench)
        for _ in range(30):
            os.write(ours, b"r")
            lead(bench, robot, jog, 1.0 / 30.0)
        lead(bench, robot, jog, 0.8)
        assert 0.030 < tool(bench)[2] - start[2] < 0.050
        assert not bench.rig.arm.state.qd_ref.any()
        jog.disconnect()
        os.close(ours)
