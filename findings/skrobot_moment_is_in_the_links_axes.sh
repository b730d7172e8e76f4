#!/bin/sh
# scikit-robot 0.4.7: RobotModel.torque_vector and inverse_dynamics with an external force and moment.
#
# Expected: force and moment, two halves of one wrench at one place, are given in the same axes.
# Seen: the force is taken in the axes of the world, the moment in those of the link. At the end of an arm of 0.1 m,
# 1 N downwards and the moment of 0.1 N m that this force has about the joint should need the same torque. The force
# needs 0.1 N m, the moment none; it does when its numbers are turned into the link's axes. The reading of a
# force-torque sensor is thus wrong in one of its halves, whichever axes it is in.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet scikit-robot==0.4.7
cd "$folder"
"$folder/venv/bin/python" - <<'PY'
from pathlib import Path

import numpy as np
from skrobot.model import RobotModel

# The joint turns about its own z, which is the world's -y.
Path("lever.urdf").write_text("""<robot name="lever"><link name="base"/> <link name="bar"/> <link name="tip"/>
<joint name="lift" type="revolute"><parent link="base"/><child link="bar"/><origin rpy="1.57079632679 0 0"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="5" velocity="3"/></joint>
<joint name="end" type="fixed"><parent link="bar"/><child link="tip"/><origin xyz="0.1 0 0"/></joint></robot>""")
robot = RobotModel()
with open("lever.urdf") as file:
    robot.load_urdf_file(file)
(tip,) = (link for link in robot.link_list if link.name == "tip")
none = np.zeros(3)


def torque(force, moment):
    """What the joint needs for it, without the links' own weight [N m]."""
    force, moment = np.array(force), np.array(moment)
    with_it = robot.torque_vector(force_list=[force], moment_list=[moment], target_coords=[tip])
    other = robot.inverse_dynamics(external_forces=[force], external_moments=[moment], external_coords=[tip])
    assert np.allclose(with_it, other)
    return (with_it - robot.torque_vector(force_list=[none], moment_list=[none], target_coords=[tip]))[0]


of_force = torque([0.0, 0.0, -1.0], none)
in_world, in_link = torque(none, [0.0, 0.1, 0.0]), torque(none, tip.worldrot().T @ [0.0, 0.1, 0.0])
print(f"1 N down at 0.1 m: {of_force:.3f} N m; its moment, axes of the world: {in_world:.3f}, of the link: {in_link:.3f}")
assert abs(of_force - 0.1) < 1e-6 and abs(in_world) < 1e-6 and abs(in_link - 0.1) < 1e-6
PY
