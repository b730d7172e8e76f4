"""Programs and motions checked against a changed scene or another calibration."""

from pathlib import Path

import numpy as np
import pytest

from so101_motion.calib.record.record import JointCalibration
from so101_motion.calib.record.store import Stored
from so101_motion.calib.record.zero import Zero
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.common.state import ARM_JOINTS
from so101_motion.drivers.bus.ticks import RAD_PER_TICK
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.program import Loop, Program, Waypoint
from so101_motion.tasks.sweeps import (
    CheckSweep,
    PlansSweep,
    ProgramCheckSweep,
    as_lerobot,
    check_summary,
    program_check_summary,
    program_text,
    run_sweep,
    scene_text,
    since,
)

AT = {"left": 40.0, "ahead": 0.0, "right": -40.0}
WAYPOINTS = tuple(
    Waypoint(name=name, q=np.radians([pan, -20.0, 20.0, 70.0, 0.0]), passes=name == "ahead")
    for name, pan in AT.items()
)
PROGRAM = Program(waypoints=WAYPOINTS, rounds=2)
FREE = scene_text(Scene())


def box(size, p):
    placed = SE3.from_translation(p)
    return Obstacle(name="box", shape=Box(size=np.array(size)), T_base_obstacle=placed)


def calibrated(**changes):
    """A calibration whose zeros are in the middles of travels of 2000 ticks."""
    joints = {
        joint: JointCalibration(id=k, homing_offset=0, range_min=1048, range_max=3048)
        for k, joint in enumerate((*ARM_JOINTS, "gripper"), 1)
    }
    zeros = {joint: Zero(by="configured", angle=0.0) for joint in ARM_JOINTS}
    return Stored(
        path=Path("arm.json"),
        calibration=joints | changes.get("joints", {}),
        zeros=zeros | changes.get("zeros", {}),
        notes=(),
    )


def checked(folder, program, **given):
    sweep = ProgramCheckSweep(program=program_text(program), **{"scene": FREE, **given})
    assert not run_sweep(sweep, folder).failed
    return program_check_summary(folder, program)


def test_a_program_in_its_own_scene_passes_whole(tmp_path):
    figures, failed = checked(tmp_path / "out", PROGRAM)
    assert failed == {}
    assert (figures["waypoints"], figures["stops"], figures["failed"]) == (3, 2, 0)
    assert figures["planned motion [s]"] > 0.5


def test_a_waypoint_in_something_new_is_named_with_what_it_is(tmp_path):
    tip = RobotModel.load().frame(WAYPOINTS[2].q, "jaw_tip").p
    scene = scene_text(Scene(obstacles=(box((0.04, 0.04, 0.04), tip),)))
    _, failed = checked(tmp_path / "out", PROGRAM, scene=scene)
    assert list(failed) == ["waypoint 3 (right)"]
    assert "'box'" in failed["waypoint 3 (right)"]


def test_a_path_too_heavy_for_the_servos_is_reported_though_its_ends_are_free(tmp_path):
    _, failed = checked(tmp_path / "out", PROGRAM, payload=1.5)
    assert list(failed) == ["the path to waypoint 1 (left)", "the path to waypoint 3 (right)"]
    assert "waypoint 1 (left): " in failed["the path to waypoint 1 (left)"]


def test_what_comes_before_the_first_stop_of_a_single_run_is_not_looked_at(tmp_path):
    once = Program(waypoints=WAYPOINTS[1:], rounds=1)
    sweep = ProgramCheckSweep(program=program_text(once), scene=FREE)
    shard = sweep.open()(0)
    assert shard["waypoint"].tolist() == [0, 1]
    alone = Program(waypoints=(WAYPOINTS[0], WAYPOINTS[2]), rounds=1)
    shard = ProgramCheckSweep(program=program_text(alone), scene=FREE).open()(0)
    assert (shard["path_problem"][0], shard["duration"][0]) == ("", 0.0)


def test_the_way_back_to_where_a_loop_begins_is_looked_at(tmp_path):
    looped = Program(waypoints=(*WAYPOINTS, WAYPOINTS[0])).with_loop(Loop(first=0, last=2, times=3))
    figures, failed = checked(tmp_path, looped)
    assert failed == {}
    assert (figures["waypoints"], figures["stops"]) == (4, 4)  # one of the ways leads back
    _, failed = checked(tmp_path / "heavy", looped, payload=5.0)
    assert any("the path to waypoint 1 " in each for each in failed)


def test_an_arm_that_is_calibrated_anew_reads_where_it_stood_at_the_same_ticks():
    """Another homing offset, another travel, another zero: one encoder."""
    elbow = JointCalibration(id=3, homing_offset=100, range_min=900, range_max=3000)
    now = calibrated(
        joints={"elbow_flex": elbow}, zeros={"elbow_flex": Zero(by="stops", angle=-0.1)}
    )
    reading = since(calibrated(), now)
    encoder = 2048 + 300  # at 300 ticks of the old angle
    expected = -0.1 + (encoder - 100 - 1950) * RAD_PER_TICK
    read = reading.angles(np.array([[0.0, 0.0, 300 * RAD_PER_TICK, 0.0, 0.0]]))[0]
    assert read == pytest.approx([0.0, 0.0, expected, 0.0, 0.0])
    assert reading.lower[2] == pytest.approx(-0.1 - 1050 * RAD_PER_TICK)


def test_calibrations_that_count_in_different_directions_are_refused():
    pan = JointCalibration(id=1, drive_mode=1, homing_offset=0, range_min=1048, range_max=3048)
    with pytest.raises(ConfigError, match="other way round"):
        since(calibrated(), calibrated(joints={"shoulder_pan": pan}))


def test_a_program_beyond_the_travel_of_another_calibration_is_reported(tmp_path):
    narrow = JointCalibration(id=1, homing_offset=0, range_min=1748, range_max=2348)
    reading = since(calibrated(), calibrated(joints={"shoulder_pan": narrow}))
    _, failed = checked(tmp_path / "out", PROGRAM, reading=reading)
    assert list(failed) == ["waypoint 1 (left)", "waypoint 3 (right)"]
    assert failed["waypoint 1 (left)"] == "shoulder_pan would be 13.6 deg beyond its travel"


def test_motions_on_an_arm_with_other_middles_fail_where_it_would_touch(tmp_path):
    """Played by LeRobot on an arm whose elbow's middle is 20 degrees off."""
    run_sweep(PlansSweep(count=5, fps=50), tmp_path / "plans")
    same = as_lerobot(
        calibrated(
            joints={
                joint: JointCalibration(id=k, homing_offset=0, range_min=300, range_max=3796)
                for k, joint in enumerate(ARM_JOINTS, 1)
            }
        )
    )
    run_sweep(CheckSweep.of(tmp_path / "plans", FREE, same), tmp_path / "same")
    assert check_summary(tmp_path / "same") == ({"motions": 5, "blocked": 0}, [])
    other = as_lerobot(calibrated(zeros={"elbow_flex": Zero(by="configured", angle=0.35)}))
    run_sweep(CheckSweep.of(tmp_path / "plans", FREE, other), tmp_path / "other")
    figures, failed = check_summary(tmp_path / "other")
    assert figures["blocked"] == len(failed) > 0
    assert sum(count for name, count in figures.items() if name.startswith("blocked by")) == len(
        failed
    )
