#!/bin/sh
# pin 4.1.0, MuJoCo 4.0.0, yourdfpy 0.0.60, urchin 0.0.30, kinpy 0.6.1, pytransform3d 3.17.0: one URDF of a parallel
# gripper, whose second finger mimics the first.
#
# Expected: where the first finger opens by 30 mm, the second does, in each program that reads URDFs.
# Seen: in yourdfpy, urchin and MuJoCo (as an equality constraint) it does. kinpy and pytransform3d leave it shut and say
# nothing; Pinocchio makes it a joint of its own, unless mimic=True is given. With that, it moves, but aba refuses the
# model and the Jacobians of joints have two columns for one velocity. A grasp or a clearance that is computed with
# kinpy, pytransform3d or Pinocchio as they come has a gripper that is half open.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pin==4.1.0 mujoco==4.0.0 yourdfpy==0.0.60 urchin==0.0.30 kinpy==0.6.1 \
    pytransform3d==3.17.0
cd "$folder"
cat >gripper.urdf <<'URDF'
<robot name="gripper">
  <link name="palm"/>
  <link name="left"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="right"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="jaw" type="prismatic"><parent link="palm"/><child link="left"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" effort="5" velocity="0.1"/></joint>
  <joint name="other_jaw" type="prismatic"><parent link="palm"/><child link="right"/><axis xyz="0 -1 0"/>
    <limit lower="0" upper="0.04" effort="5" velocity="0.1"/><mimic joint="jaw" multiplier="1" offset="0"/></joint>
</robot>
URDF
venv/bin/python - <<'PY'
from pathlib import Path

import kinpy
import mujoco
import numpy as np
import pinocchio
import urchin
import yourdfpy
from pytransform3d.urdf import UrdfTransformManager

OPEN, text, seen = 0.03, Path("gripper.urdf").read_text(), {}

model = yourdfpy.URDF.load("gripper.urdf")
model.update_cfg([OPEN])
seen["yourdfpy"] = model.get_transform("right", "palm")[1, 3]

placed = urchin.URDF.load("gripper.urdf").link_fk(cfg={"jaw": OPEN})
seen["urchin"] = next(T for link, T in placed.items() if link.name == "right")[1, 3]

model = mujoco.MjModel.from_xml_path("gripper.urdf")
assert (model.njnt, model.neq) == (2, 1)

placed = kinpy.build_chain_from_urdf(text).forward_kinematics({"jaw": OPEN})
seen["kinpy"] = placed["right"].pos[1]

model = UrdfTransformManager()
model.load_urdf(text)
model.set_joint("jaw", OPEN)
seen["pytransform3d"] = model.get_transform("right", "palm")[1, 3]

assert pinocchio.buildModelFromUrdf("gripper.urdf").nv == 2
model = pinocchio.buildModelFromUrdf("gripper.urdf", mimic=True)
data, q = model.createData(), np.array([OPEN])
pinocchio.framesForwardKinematics(model, data, q)
seen["pin, mimic=True"] = data.oMf[model.getFrameId("right")].translation[1]
columns = pinocchio.computeJointJacobians(model, data, q).shape[1]
try:
    pinocchio.aba(model, data, q, np.zeros(1), np.zeros(1))
except RuntimeError as error:
    refused = str(error)

for program, y in seen.items():
    print(f"{program}: the second finger is {abs(y) * 1e3:.0f} mm out")
print(f"pin, mimic=True: {model.nv} velocity, Jacobian of {columns} columns; aba: {refused}")
out = {program for program, y in seen.items() if np.isclose(y, -OPEN)}
shut = {program for program, y in seen.items() if np.isclose(y, 0.0)}
assert out == {"yourdfpy", "urchin", "pin, mimic=True"} and shut == {"kinpy", "pytransform3d"}
assert (model.nv, columns) == (1, 2) and "Mimic" in refused
PY
