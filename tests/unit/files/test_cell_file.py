"""cell.json: what is read, refused and written."""

import json

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, rot_x, rot_z
from so101_motion.files.cell_file import read_cell, write_cell
from so101_motion.rig.cell_rigs import open_cell

CELL = {
    "arms": [
        {"name": "left", "port": "/dev/ttyACM0", "position_mm": [0, 0, 20]},
        {
            "name": "right",
            "port": "/dev/ttyACM1",
            "calibration_id": "two",
            "position_mm": [350, 0, 0],
            "rpy_deg": [0, 0, 180],
        },
    ],
    "scene": {
        "floor_z_mm": -2.4,
        "obstacles": [{"name": "box", "box_mm": [80, 80, 80], "position_mm": [175, 200, 40]}],
    },
}


def written(tmp_path, content):
    path = tmp_path / "cell.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_arms_are_read_and_each_sees_the_scene_from_its_own_base(tmp_path):
    cell = read_cell(written(tmp_path, CELL))
    left, right = cell.arms
    assert (left.name, left.port, left.calibration_id) == ("left", "/dev/ttyACM0", "")
    assert right.calibration_id == "two"
    np.testing.assert_allclose(right.T_cell_base.p, [0.35, 0.0, 0.0])
    np.testing.assert_allclose(right.T_cell_base.R, rot_z(np.pi), atol=1e-12)
    left, right = (cell.scene_of(arm) for arm in cell.arms)
    np.testing.assert_allclose(left.obstacles[0].T_base_obstacle.p, [0.175, 0.2, 0.02])
    np.testing.assert_allclose(right.obstacles[0].T_base_obstacle.p, [0.175, -0.2, 0.04])
    assert left.floor_z == pytest.approx(-0.0224)
    assert right.floor_z == pytest.approx(-0.0024)


def test_a_written_file_reads_back_the_same_with_what_arms_hold(tmp_path):
    cell = read_cell(written(tmp_path, CELL))
    moved = SE3.from_rpy((0.0, 0.0, 3.0), (0.4, 0.01, 0.0))
    path = tmp_path / "again.json"
    write_cell(cell.with_bases({"right": moved}), path)
    left, right = read_cell(path).arms
    np.testing.assert_allclose(right.T_cell_base.p, moved.p, atol=1e-6)
    np.testing.assert_allclose(right.T_cell_base.R, moved.R, atol=1e-5)
    assert (left.port, right.calibration_id) == ("/dev/ttyACM0", "two")
    stick = {"name": "stick", "box_mm": [20, 20, 160], "position_mm": [0, 0, 150], "mass_kg": 0.04}
    content = {"arms": [{**CELL["arms"][0], "attached": [stick]}, CELL["arms"][1]]}
    path = tmp_path / "again.json"
    write_cell(read_cell(written(tmp_path, content)), path)
    cell = read_cell(path)
    left, right = (cell.scene_of(arm) for arm in cell.arms)
    [held] = left.attached
    assert (held.name, held.mass) == ("stick", 0.04)
    np.testing.assert_allclose(held.T_tool_object.p, [0.0, 0.0, 0.15])
    assert right.attached == ()


def test_a_floor_needs_arms_that_stand_upright(tmp_path):
    leaning = {"arms": [{"name": "wall", "rpy_deg": [90, 0, 0]}]}
    cell = read_cell(written(tmp_path, leaning))
    with pytest.raises(ConfigError, match="upright"):
        cell.scene_of(cell.arms[0])
    free = read_cell(written(tmp_path, leaning | {"scene": {"floor_z_mm": None}}))
    assert free.scene_of(free.arms[0]).floor_z is None
    np.testing.assert_allclose(free.arms[0].T_cell_base.R, rot_x(np.pi / 2), atol=1e-12)


def test_nobody_drives_an_arm_faster_than_its_cell_allows(tmp_path):
    content = {"arms": [{"name": "anna", "max_speed_degs_per_sec": 30, "tool": "uvc-32x32"}]}
    path = tmp_path / "again.json"
    write_cell(read_cell(written(tmp_path, content)), path)
    with open_cell(read_cell(path)) as opened:
        arm = opened.rigs["anna"].arm
        np.testing.assert_allclose(arm.speed, np.radians(30.0))
        assert arm.tool.name == "uvc-32x32"
        with pytest.raises(ConfigError, match=r"max_speed_degs_per_sec, 30 deg/s"):
            arm.set_speed(np.radians(31.0))
