"""Two arms as one robot of LeRobot."""

import json
from contextlib import closing

import numpy as np
import pytest
from harness.emulated_rig import MIDDLES_DEG
from harness.facing_arms import distance
from harness.lerobot_bench import (
    READY,
    BiSO101Motion,
    BiSO101MotionConfig,
    GreyConfig,
    LeRobotBench,
    SO101MotionArmConfig,
    action,
)

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, rot_z
from so101_motion.planning.collision.arm_bodies import bodies_of

START = (*np.radians(np.add(READY[:5], MIDDLES_DEG)), 0.5)


class TwoArms(LeRobotBench):
    """A second arm beside the first, on the same clock."""

    def __init__(self, folder):
        super().__init__(folder / "left", q_start=START)
        self.other = LeRobotBench(folder / "right", clock=self.clock, q_start=START)

    def open_rig(self, settings):
        is_ours = settings.port == str(self.port)
        return super().open_rig(settings) if is_ours else self.other.open_rig(settings)

    def close(self):
        super().close()
        self.other.close()


@pytest.fixture
def made(tmp_path):
    """Makes the robot, of sides with the same settings."""
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
    with closing(TwoArms(tmp_path)) as bench:

        def make(of_each=None, **settings):
            ports = (str(each.port) for each in (bench, bench.other))
            sides = (SO101MotionArmConfig(port=port, **(of_each or {})) for port in ports)
            config = BiSO101MotionConfig(*sides, id="two", calibration_dir=tmp_path, **settings)
            robot = BiSO101Motion(config)
            for each in robot.arms.values():
                each.open_rig, each.wait = bench.open_rig, bench.wait
            return robot, bench

        yield make


@pytest.fixture
def robot(tmp_path, request, made):
    cell = None
    if hasattr(request, "param"):
        cell = tmp_path / "cell.json"
        cell.write_text(json.dumps({"arms": request.param}))
    robot, bench = made(cell=cell)
    robot.connect(calibrate=False)
    yield robot, bench
    if robot.is_connected:
        robot.disconnect()


def both(left, right):
    named = (("left_", left), ("right_", right))
    return {side + key: value for side, each in named for key, value in action(*each).items()}


def test_each_arm_goes_to_its_own_targets(robot):
    robot, bench = robot
    left, right = (4.0, *READY[1:]), (-4.0, *READY[1:])
    assert list(robot.action_features) == list(both(READY, READY))
    for _ in range(40):
        taken = robot.send_action(both(left, right))
        bench.advance(1.0 / 30.0)
    assert taken == pytest.approx(both(left, right))
    seen = robot.get_observation()
    assert seen["left_shoulder_pan.pos"] == pytest.approx(4.0, abs=0.5)
    assert seen["right_shoulder_pan.pos"] == pytest.approx(-4.0, abs=0.5)


FACING = [
    {"name": "left", "position_mm": [0, 0, 0]},
    {"name": "right", "position_mm": [600, 0, 0], "rpy_deg": [0, 0, 180]},
]


@pytest.mark.parametrize("robot", [FACING], indirect=True)
def test_with_a_cell_two_arms_that_are_sent_at_each_other_stay_apart(robot, caplog):
    robot, bench = robot
    ahead, nearest = (0.0, 20.0, -20.0, 20.0, 0.0, 30.0), np.inf
    bodies, T = bodies_of(), SE3(rot_z(np.pi), np.array([0.6, 0.0, 0.0]))
    for _ in range(90):  # they meet, and slide along each other
        robot.send_action(both(ahead, ahead))
        bench.advance(1.0 / 30.0)
        left, right = (each.rig.arm.state for each in (bench, bench.other))
        at = (np.append(each.q, each.q_jaw) for each in (left, right))
        nearest = min(nearest, distance(bodies, *at, T))
    assert 0.005 < nearest < 0.020
    assert "is held back by" in caplog.text


def test_a_cell_of_other_arms_and_one_port_under_two_names_are_refused(tmp_path):
    cell = tmp_path / "cell.json"
    cell.write_text(json.dumps({"arms": FACING[:1]}))
    sides = (SO101MotionArmConfig(port=str(tmp_path / side)) for side in ("left", "right"))
    config = BiSO101MotionConfig(*sides, id="two", calibration_dir=tmp_path, cell=cell)
    with pytest.raises(ConfigError, match='"left" and "right"'):
        BiSO101Motion(config)
    (tmp_path / "by-id").symlink_to(tmp_path / "port")
    sides = (SO101MotionArmConfig(port=str(tmp_path / name)) for name in ("port", "by-id"))
    with pytest.raises(ConfigError, match="is the port of the left arm"):
        BiSO101Motion(BiSO101MotionConfig(*sides, id="two"))


def test_cameras_of_neither_arm_have_no_prefix_and_are_read_and_closed(made):
    grey = GreyConfig(fps=30, width=8, height=6)
    robot, _ = made({"cameras": {"wrist": grey}}, cameras={"top": grey})
    pictures = {"top", "left_wrist", "right_wrist"}
    assert set(robot.cameras) == pictures
    assert pictures <= set(robot.observation_features)
    robot.connect(calibrate=False)
    assert {robot.get_observation()[name].shape for name in pictures} == {(6, 8, 3)}
    robot.disconnect()
    assert not any(camera.is_connected for camera in robot.cameras.values())
    with pytest.raises(ValueError, match="camera top is among those of the left arm"):
        made({"cameras": {"top": grey}}, cameras={"top": grey})


def test_an_arm_that_cannot_be_opened_leaves_the_other_closed(robot):
    robot, bench = robot
    robot.disconnect()
    bench.other.emulator.unplug()
    with pytest.raises(ConnectionError):
        robot.connect(calibrate=False)
    assert not robot.is_connected
    bench.other.emulator.plug()
