"""Other kinds of arm are files: the SO-100 of the package, and one that a user wrote."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from so101_description.robots import BUILT_IN, RobotFileError, load_robot

TRY = """
import numpy as np
import so101_description
from so101_motion.arm.gripper import JAW_OPEN
from so101_motion.common.named_poses import POSES
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import JointGoal, PoseGoal
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.viam.conversion.kinematics import arm_sva
from so101_motion.viam.conversion.meshes import arm_geometries

model = RobotModel.load()
ik, misses = IkSolver(model), []
for q in np.random.default_rng(1).uniform(model.lower, model.upper, (40, 5)):
    T = model.frame(q)
    found = ik.solve(PoseGoal(T_base_tool=T), np.zeros(5)).q
    misses.append(np.linalg.norm(model.frame(found).p - T.p))
collision = CollisionModel(model, Scene())
contacts = {pose.name: collision.first_contact(pose.q, 0.0) for pose in POSES}
limits = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=20.0)
plan = Planner(model).plan(
    PlanRequest(q_start=POSES[0].q, goal=JointGoal(q=POSES[1].q), limits=limits)
)
sva = arm_sva("arm")
drawn = arm_geometries("arm", model.link_placements(POSES[0].q, 0.0), None)
print(repr((so101_description.ROBOT.name, max(misses), contacts, plan.trajectory.duration,
            model.upper.tolist(), JAW_OPEN, len(sva), len(drawn))))
"""


def tried(robot: str) -> tuple:
    """What a process of this kind of arm finds."""
    out = subprocess.run(
        [sys.executable, "-c", TRY],
        env={**os.environ, "SO101_ROBOT": robot},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return eval(out.stdout)


def free_of_contact(contacts: dict) -> bool:
    return all(contact is None for contact in contacts.values())


def test_the_so_100_is_planned_for():
    name, miss, contacts, duration, upper, jaw_open, _, drawn = tried("so100")
    assert name == "SO-100"
    assert miss < 1e-6, "its own closed forms, from its URDF"
    assert free_of_contact(contacts)
    assert duration > 1.0
    assert upper[1] == pytest.approx(1.7)
    assert jaw_open == 2.0
    assert drawn == 5


@pytest.fixture
def own_file(tmp_path: Path) -> Path:
    """An arm with published figures of the SO-ARM 102: lengths and ranges; its shape is invented.

    Robonine, SO-ARM-102, docs/specifications.md: links of 119, 139 and 62 mm; ranges of 352 deg of
    the pan, and of 166 to one side and 77 to the other of a straight elbow.
    """
    text = (BUILT_IN["so101"].parent / "so101.urdf").read_text()
    text = text.replace("-0.11257 -0.028 0", "-0.119 0 0").replace("-0.1349 0.0052 0", "-0.139 0 0")
    text = text.replace("0 -0.0611 0.0181", "0 -0.062 0.0181")
    text = text.replace('"-1.91986" upper="1.91986"', '"-3.0718" upper="3.0718"')
    text = text.replace('"-1.69" upper="1.5848"', '"-2.9147" upper="1.3264"')
    box = '<origin xyz="-0.02 0 0.01" rpy="0 0 1.5708"/><geometry><box size="0.03 0.03 0.03"/>'
    text = re.sub(r'<geometry><mesh filename="meshes/\w+_hull.obj"/>', box, text)
    (tmp_path / "arm.urdf").write_text(text)
    known = json.loads(BUILT_IN["so101"].read_text())
    own = {key: known[key] for key in ("schema", "tcp_mm", "poses_deg")}
    own |= {"name": "mine", "urdf": "arm.urdf", "stall_nm": {"12": 4.9}}
    (tmp_path / "arm.json").write_text(json.dumps(own))
    return tmp_path / "arm.json"


def test_a_file_of_ones_own_is_planned_for(own_file):
    name, miss, contacts, duration, upper, *_ = tried(str(own_file))
    assert name == "mine"
    assert miss < 1e-6
    assert free_of_contact(contacts)
    assert duration > 1.0
    assert upper[0] == pytest.approx(3.0718)


def test_a_box_stands_where_its_origin_says_and_a_joint_about_another_axis_is_refused(own_file):
    corners = load_robot(str(own_file)).hull("wrist_link").vertices
    np.testing.assert_allclose(corners.min(axis=0), [-0.035, -0.015, -0.005], atol=1e-6)
    urdf = own_file.with_name("arm.urdf")
    urdf.write_text(urdf.read_text().replace('<axis xyz="0 0 1"/>', '<axis xyz="0 1 0"/>', 1))
    with pytest.raises(RobotFileError, match="shoulder_pan must turn about its own z"):
        load_robot(str(own_file))


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("poses_deg", None, "poses_deg is missing"),
        ("poses_deg", {"home": [0] * 5}, "must give home, ready, rest"),
        ("schema", "x", "must be an object with the schema"),
        ("urdf", "none.urdf", "No such file"),
        ("stops_deg", {"elbow_flex": [0, 1]}, "must give shoulder_pan"),
    ],
)
def test_a_wrong_file_says_what_is_wrong(own_file, key, value, says):
    given = json.loads(own_file.read_text())
    given[key] = value
    if value is None:
        del given[key]
    own_file.write_text(json.dumps(given))
    with pytest.raises(RobotFileError, match=re.escape(says)):
        load_robot(str(own_file))
