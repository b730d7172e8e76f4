#!/bin/sh
# pin 4.1.0 beside mujoco 4.0.0: <dynamics damping="" friction=""> of a URDF joint.
#
# Expected: two libraries that both read the element give one acceleration for one state.
# Seen: Pinocchio stores both values in the model (model.damping, model.friction), and no dynamics
# algorithm uses them: aba() answers as for a joint without losses. MuJoCo applies them. A pendulum of
# 0.3 kg with 0.6 Nms/rad that turns at 2 rad/s is slowed 14 times harder in MuJoCo.
# Whoever identifies friction with one and simulates with the other has to add the torque by hand.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pin==4.1.0 mujoco==4.0.0 "numpy<3"
"$folder/venv/bin/python" - <<'PY'
import mujoco
import numpy as np
import pinocchio as pin

URDF = """<robot name="pendulum"><link name="base"/>
<link name="rod"><inertial><origin xyz="0 0 -0.1"/><mass value="0.3"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="3" velocity="5"/><dynamics damping="0.6" friction="0.05"/></joint></robot>"""
q, qd, tau = np.array([0.3]), np.array([2.0]), np.zeros(1)

model = pin.buildModelFromXML(URDF)
in_pinocchio = pin.aba(model, model.createData(), q, qd, tau)[0]
at_rest = pin.aba(model, model.createData(), q, 0.0 * qd, tau)[0]
twin = mujoco.MjModel.from_xml_string(URDF)
state = mujoco.MjData(twin)
state.qpos[:], state.qvel[:] = q, qd
mujoco.mj_forward(twin, state)
in_mujoco = state.qacc[0]

print(f"stored by Pinocchio: damping {model.damping}, friction {model.friction}")
print(f"Pinocchio {in_pinocchio:.1f} rad/s2 at 2 rad/s, {at_rest:.1f} at rest; MuJoCo {in_mujoco:.1f} at 2 rad/s")
assert model.damping[0] == 0.6 and model.friction[0] == 0.05
assert np.isclose(in_pinocchio, at_rest), "Pinocchio uses the damping now"
assert in_mujoco / in_pinocchio > 10.0
PY
