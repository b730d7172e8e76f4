#!/bin/sh
# pin 4.1.0 beside MuJoCo 4.0.0: buildModelFromMJCF of an arm whose forearm is turned with axisangle="1 1 0 90".
#
# Expected: a turn by 90 degrees about the diagonal, whatever the length of the vector, as MuJoCo reads it, and as Pinocchio
# itself reads the same vector as the axis of a joint and a quaternion that is not of length 1.
# Seen: the vector is taken as it stands, and what is stored as the forearm's rotation has the determinant 6: a hand 0.3 m before
# the elbow is 0.74 m away from it. With a vector of length 1 all is right. The frame of an <inertial> is read the same way, so
# inertias change, too. No error, no warning.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pin==4.1.0 mujoco==4.0.0 "numpy<3"
"$folder/venv/bin/python" - "$folder/arm.xml" <<'PY'
import sys

import mujoco
import numpy as np
import pinocchio as pin

turns = {
    "axis of length 1": 'axisangle="0.70710678 0.70710678 0 90"',
    "axis of another length": 'axisangle="1 1 0 90"',
    "quaternion of length 2.83": 'quat="2 1.41421356 1.41421356 0"',
}
size = '<geom type="box" size="0.02 0.02 0.02" mass="0.1"/>'
away, determinant = {}, {}
for what, turn in turns.items():
    hand = f'<body name="hand" pos="0.3 0 0">{size}</body>'
    forearm = f'<body name="forearm" pos="0.2 0 0" {turn}><joint axis="0 1 0"/>{size}{hand}</body>'
    with open(sys.argv[1], "w") as file:
        file.write(f'<mujoco><worldbody><body name="arm"><joint axis="0 1 0"/>{size}{forearm}</body></worldbody></mujoco>')
    there, here = mujoco.MjModel.from_xml_path(sys.argv[1]), pin.buildModelFromMJCF(sys.argv[1])
    state, data = mujoco.MjData(there), here.createData()
    mujoco.mj_forward(there, state)
    pin.framesForwardKinematics(here, data, pin.neutral(here))
    hand, forearm = (data.oMf[here.getFrameId(name)] for name in ("hand", "forearm"))
    vectors = state.body("hand").xpos - state.body("forearm").xpos, hand.translation - forearm.translation
    away[what] = np.linalg.norm(vectors, axis=1)
    determinant[what] = np.linalg.det(forearm.rotation)
    print(f"{what}: from elbow to hand {away[what].round(3)} m in MuJoCo and Pinocchio, determinant {determinant[what]:.2f}")
stretched = away.pop("axis of another length"), determinant.pop("axis of another length")
assert np.allclose(list(away.values()), 0.3, atol=1e-6) and np.allclose(list(determinant.values()), 1.0, atol=1e-6)
assert abs(stretched[0][0] - 0.3) < 1e-6 and stretched[0][1] > 0.31 and stretched[1] > 1.1, stretched
PY
