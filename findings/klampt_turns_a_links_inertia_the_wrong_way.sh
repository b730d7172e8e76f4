#!/bin/sh
# klampt 0.10.1.post1 beside pin 4.1.0: the <inertial> of a URDF link, whose <origin rpy> is not zero.
#
# Expected: what is measured in the turned frame is turned into the link's: a slender bar that lies at +45 degrees in its link
# resists a turn about the axis at right angles to it, and hardly one about its own length.
# Seen: it is turned the other way, as if the bar lay at -45 degrees; by 90 degrees that makes no difference. About its length
# the bar has 41 times its inertia, and across it a 41st, so the mass matrix and the torque for an acceleration are wrong,
# while the centre of mass is where it should be and the torque of gravity is right.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet klampt==0.10.1.post1 pin==4.1.0 "numpy<3"
"$folder/venv/bin/python" - "$folder/bar.urdf" <<'PY'
import math
import sys

import klampt
import numpy as np
import pinocchio as pin

BAR = '<mass value="0.5"/><inertia ixx="0.0041" iyy="0.0041" izz="0.0001" ixy="0" ixz="0" iyz="0"/>'
LIMIT = '<limit lower="-2" upper="2" effort="3" velocity="2"/>'
AXES = {"along the bar": "0 -0.70710678 0.70710678", "across the bar": "0 0.70710678 0.70710678"}


def inertia(roll, axis):
    inertial = f'<inertial><origin xyz="0 0 0" rpy="{roll} 0 0"/>{BAR}</inertial>'
    joint = f'<origin xyz="0 0 0" rpy="0 0 0"/><parent link="base"/><child link="bar"/><axis xyz="{axis}"/>{LIMIT}'
    with open(sys.argv[1], "w") as file:
        file.write(f'<robot name="r"><link name="base"/><link name="bar">{inertial}</link>')
        file.write(f'<joint name="j" type="revolute">{joint}</joint></robot>')
    world = klampt.WorldModel()
    assert world.loadElement(sys.argv[1]) >= 0
    robot, model = world.robot(0), pin.buildModelFromUrdf(sys.argv[1])
    moving = robot.link("bar").index
    return np.array([robot.getMassMatrix()[moving][moving], pin.crba(model, model.createData(), np.zeros(1))[0, 0]])


found = {name: inertia(math.pi / 4, axis) for name, axis in AXES.items()}
for name, (in_klampt, in_pinocchio) in found.items():
    print(f"at 45 deg, {name}: {in_klampt:.4f} kgm2 in Klampt, {in_pinocchio:.4f} in Pinocchio")
upright = inertia(0.0, "0 0 1"), inertia(math.pi / 2, "0 1 0")
print("at 0 and at 90 deg, along the bar:", np.round(upright, 4).tolist())
assert np.allclose(found["along the bar"], (0.0041, 0.0001), atol=1e-6)
assert np.allclose(found["across the bar"], (0.0001, 0.0041), atol=1e-6)
assert np.allclose(upright, 0.0001, atol=1e-6)
PY
