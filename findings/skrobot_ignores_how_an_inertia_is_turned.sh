#!/bin/sh
# scikit-robot 0.4.7: torques that a motion needs (torque_vector, which uses inverse_dynamics).
#
# Expected: the inertia of a link is that of its inertial frame, which <origin rpy="..."> turns, as URDF has it.
# Seen: the place of the centre of mass is read from <origin>, its rotation is not. A wheel with 0.001, 0.002 and
# 0.003 kg m^2 about x, y and z, turned by a quarter about x, has 0.002 kg m^2 about its axle. The torque for 1 rad/s^2
# is 0.003 N m, the same as without the rotation. No error, no warning. Exporters from CAD write such rotations.
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

LIMIT = '<limit lower="-2" upper="2" effort="5" velocity="3"/>'
PLAIN = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
DT = 0.01


def torque(rpy):
    """For 1 rad/s^2 about the axle from rest [N m]."""
    Path("spinner.urdf").write_text(f"""<robot name="spinner"><link name="base">{PLAIN}</link>
<link name="hub">{PLAIN}</link> <link name="wheel"><inertial><origin rpy="{rpy}"/><mass value="1"/>
<inertia ixx="0.001" iyy="0.002" izz="0.003" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="swivel" type="revolute"><parent link="base"/><child link="hub"/><axis xyz="1 0 0"/>{LIMIT}</joint>
<joint name="axle" type="revolute"><parent link="hub"/><child link="wheel"/><axis xyz="0 0 1"/>{LIMIT}</joint></robot>""")
    robot = RobotModel()
    with open("spinner.urdf") as file:
        robot.load_urdf_file(file)
    now, beside = np.zeros(2), np.array([0.0, 0.5 * DT**2])
    return robot.torque_vector(calc_statics_p=False, dt=DT, av=now, av_prev=beside, av_next=beside)[1]


plain, turned = torque("0 0 0"), torque("1.57079632679 0 0")
print(f"1 rad/s^2 takes {plain:.4f} N m, with the inertia turned by a quarter {turned:.4f}; 0.0020 is right")
assert abs(plain - 0.003) < 1e-6 and abs(turned - 0.003) < 1e-6
PY
