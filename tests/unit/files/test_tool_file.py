"""What is fixed to the gripper: in kinematics, checks, load, and Viam's geometries."""

import json

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError, PlanningError
from so101_motion.common.geometry import SE3
from so101_motion.common.named_poses import POSES
from so101_motion.files.tool_file import find_tool, presets, tool_from
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Attached, Box, Obstacle, Scene
from so101_motion.planning.goals import PoseGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.torque import carried
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.viam.conversion.kinematics import gripper_sva
from so101_motion.viam.conversion.meshes import box_around, tool_geometries

PEN = {
    "name": "pen",
    "tcp": {"position_mm": [0, 0, 150]},
    "parts": [{"name": "pen", "box_mm": [8, 8, 60], "position_mm": [0, 0, 120], "mass_kg": 0.05}],
}


@pytest.fixture(scope="module")
def rig():
    with open_simulated(q_start=POSES[1].q) as rig:
        yield rig
        rig.arm.set_tool(None)


@pytest.mark.parametrize("name", sorted(presets()))
def test_presets_name_their_sources_and_are_clear_of_the_arm_in_the_named_poses(name):
    tool = find_tool(name)
    assert "commit" in tool.source
    assert {"tcp", "camera"} == set(tool.frames)
    model, scene = RobotModel.load(), tool.on(Scene())
    collision = CollisionModel(model, scene)
    for pose in POSES:
        for roll in (0.0, 1.5) if pose.name == "rest" else (-1.5, 0.0, 1.5):
            q = np.array([*pose.q[:4], roll])
            assert collision.first_contact(q, 0.0) is None, (pose.name, roll)


def test_its_point_is_a_frame_of_goals_and_of_the_arm(rig):
    rig.arm.set_tool(tool_from(PEN))
    p = np.array([0.22, 0.05, 0.02])
    plan = rig.arm.plan(PoseGoal.at_point(p, frame="tcp"))
    reached = rig.arm.model.frame(plan.q_goal, "tcp").p
    np.testing.assert_allclose(reached, p, atol=1e-4)
    np.testing.assert_allclose(
        rig.arm.T_base("tcp").p, (rig.arm.T_base() @ SE3.from_translation([0, 0, 0.15])).p
    )
    rig.arm.set_tool(None)
    with pytest.raises(ConfigError, match="tcp"):
        rig.arm.T_base("tcp")


def test_it_is_kept_off_obstacles_in_whatever_scene_and_leaves_with_the_tool(rig):
    arm = rig.arm
    at = arm.T_base() @ SE3.from_translation([0.0, -0.06, 0.005])
    box = Obstacle(name="box", shape=Box(size=(0.02,) * 3), T_base_obstacle=SE3(np.eye(3), at.p))
    arm.scene = Scene(obstacles=(box,))
    assert arm.touching() == ""
    arm.set_tool(find_tool("uvc-32x32"))
    assert "camera" in arm.touching()
    cube = Attached(
        name="cube", shape=Box(size=(0.02,) * 3), T_tool_object=SE3.from_translation([0, 0, 0.1])
    )
    arm.scene = Scene(obstacles=(box,), attached=(cube,))
    parts = [part.name for part in arm.tool.parts]
    assert [each.name for each in arm.scene.attached] == [*parts, "cube"]
    same = arm.scene
    arm.scene = same
    assert arm.scene is same
    with pytest.raises(PlanningError, match="camera"):
        arm.plan(np.add(arm.q, (0.0, 0.0, 0.0, 0.0, 0.001)))
    arm.set_tool(None)
    assert [each.name for each in arm.scene.attached] == ["cube"]
    arm.scene = Scene()


def test_its_mass_and_its_place_are_carried():
    tool = find_tool("realsense-d405")
    load = carried(None, tool.on(Scene()).attached)
    assert load.mass == pytest.approx(0.082)
    assert load.com[1] == pytest.approx(-0.0647, abs=1e-4), "beside the gripper"


def test_viam_has_its_bodies_and_its_point():
    tool = tool_from(PEN)
    (geometry,) = tool_geometries(tool)
    assert (geometry.label, geometry.center.z, geometry.box.dims_mm.z) == ("pen", 120.0, 60.0)
    parts = [(each.name, each.T_tool_object, box_around(each)) for each in tool.parts]
    links = json.loads(gripper_sva("gripper", "follower", parts, tool.frames["tcp"]))["links"]
    assert [link["id"] for link in links] == ["pen", "tcp"]
    assert links[1]["translation"]["z"] == pytest.approx(150.0)
    plain = json.loads(gripper_sva("gripper", "follower", []))["links"]
    assert plain[0]["translation"] == {"x": 6.835, "y": 0.0, "z": 99.9}


def test_a_mesh_of_ones_own_from_a_file(tmp_path):
    (tmp_path / "finger.obj").write_text(
        "v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 40\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    part = {"name": "finger", "mesh_file": "finger.obj", "position_mm": [0, 0, 80]}
    (tmp_path / "finger.json").write_text(json.dumps({"parts": [part]}))
    tool = find_tool(str(tmp_path / "finger.json"))
    assert tool.name == "finger"
    np.testing.assert_allclose(box_around(tool.parts[0]).size, [0.01, 0.01, 0.04], atol=1e-6)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("uvc-32x33", 'did you mean "uvc-32x32"'),
        ("none.json", "none.json"),
        (3, "must be a name"),
        ({"tcp": [0, 0, 1]}, "must be a pose"),
        ({"parts": [{"name": "x"}]}, "needs exactly one form"),
        ({"tpc": {}}, "tcp"),
    ],
)
def test_what_is_no_tool_is_refused_with_a_reason(given, says):
    with pytest.raises(ConfigError, match=says):
        find_tool(given)
