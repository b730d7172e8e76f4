#!/bin/sh
# urdf2mjcf 0.2.39, read by MuJoCo 4.0.0: an arm with an elbow and a sliding jaw.
#
# Expected: the limits that the URDF states, whether the file is written with angle="radian" or "degree"; a joint without
# <axis> turns about x, URDF's default.
# Seen: with "degree" every range is multiplied by 57.3, that of the sliding jaw as well: it opens by 2.3 m instead of
# 40 mm. So is the range of the motors, which is in Nm: a servo with 3 Nm may be commanded 172.
# In both units a joint without <axis> gets none in the MJCF, where the default is z: the elbow turns about another axis.
# MuJoCo's own reader of the same URDF gets all of it right.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet urdf2mjcf==0.2.39 mujoco==4.0.0
cd "$folder"
cat > arm.urdf <<'URDF'
<robot name="arm">
  <link name="base"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="forearm"><inertial><origin xyz="0 0 0.1"/><mass value="0.1"/>
    <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="finger"><inertial><origin xyz="0 0 0.02"/><mass value="0.02"/>
    <inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="elbow" type="revolute"><parent link="base"/><child link="forearm"/>
    <limit lower="-1.5" upper="1.5" effort="3" velocity="5"/></joint>
  <joint name="jaw" type="prismatic"><parent link="forearm"/><child link="finger"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" effort="3" velocity="0.1"/></joint>
</robot>
URDF
venv/bin/python - <<'PY'
import mujoco
from urdf2mjcf.convert import convert_urdf_to_mjcf
from urdf2mjcf.model import ActuatorMetadata, ConversionMetadata, JointMetadata

gains = {"kp": 1.0, "kd": 1.0, "soft_torque_limit": 3.0, "min_angle_deg": -90.0, "max_angle_deg": 90.0}
joints = {name: JointMetadata(actuator_type="servo", id=i, nn_id=i, **gains) for i, name in enumerate(("elbow", "jaw"))}
servo = {"servo": ActuatorMetadata(actuator_type="servo", max_torque=3.0)}
models = {"MuJoCo's own reader": mujoco.MjModel.from_xml_path("arm.urdf")}
for angle in ("radian", "degree"):
    asked = ConversionMetadata(angle=angle, floating_base=False)
    convert_urdf_to_mjcf("arm.urdf", "arm.xml", metadata=asked, joint_metadata=joints, actuator_metadata=servo)
    models[angle] = mujoco.MjModel.from_xml_path("arm.xml")
seen = {}
for name, model in models.items():
    opens, elbow = model.joint("jaw").range[1], model.joint("elbow")
    torque = model.actuator_ctrlrange[:, 1].tolist()
    seen[name] = (round(elbow.range[1], 3), round(opens, 3), elbow.axis.tolist(), torque)
    print(f"{name}: elbow to {seen[name][0]} rad about {seen[name][2]}, jaw opens by {opens:.3f} m, motors' range {torque}")
assert seen["MuJoCo's own reader"] == (1.5, 0.04, [1.0, 0.0, 0.0], [])
assert seen["radian"] == (1.5, 0.04, [0.0, 0.0, 1.0], [3.0, 3.0])
assert seen["degree"] == (1.5, 2.292, [0.0, 0.0, 1.0], [171.887, 171.887])
PY
