#!/bin/sh
# pin 4.1.0 beside MuJoCo 4.0.0: buildModelFromMJCF of a world with more than one body, or with a <frame>.
#
# Expected: the joints that MuJoCo finds in the file, or an error for what is not supported.
# Seen: only the first body below <worldbody> is read, with what hangs on it. Of two arms one is left; of an arm that comes after
# a table nothing, a model without joints; the same two bodies in the other order give the arm. A body in a <frame>, which is
# MuJoCo's way to shift or turn a part of a model, is left out as well, and its weight with it: the arm's shoulder has 1.50 Nm
# to hold instead of 3.22. All without a word.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pin==4.1.0 mujoco==4.0.0 "numpy<3"
"$folder/venv/bin/python" - "$folder/world.xml" <<'PY'
import sys

import mujoco
import numpy as np
import pinocchio as pin


def arm(name, forearm_in="{}"):
    box = '<geom type="box" size="0.1 0.02 0.02" pos="0.1 0 0" mass="{}"/>'
    forearm = f'<body pos="0.2 0 0"><joint name="{name}_elbow" axis="0 1 0"/>{box.format(0.5)}</body>'
    return f'<body name="{name}"><joint name="{name}_shoulder" axis="0 1 0"/>{box.format(1.53)}{forearm_in.format(forearm)}</body>'


table = '<body name="table"><geom type="box" size="0.4 0.4 0.02" pos="0 0 -0.1" mass="8"/></body>'
frame = '<frame pos="0.05 0 0">{}</frame>'
worlds = {
    "an arm": arm("left"),
    "an arm, then a table": arm("left") + table,
    "a table, then an arm": table + arm("left"),
    "two arms": arm("left") + arm("right"),
    "an arm with its forearm in a frame": arm("left", frame),
}
joints, torque_Nm = {}, {}
for what, bodies in worlds.items():
    with open(sys.argv[1], "w") as file:
        file.write(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    there, here = mujoco.MjModel.from_xml_path(sys.argv[1]), pin.buildModelFromMJCF(sys.argv[1])
    state = mujoco.MjData(there)
    mujoco.mj_forward(there, state)
    shoulder = pin.computeGeneralizedGravity(here, here.createData(), pin.neutral(here))[:1]
    joints[what] = there.njnt, here.njoints - 1
    torque_Nm[what] = abs(state.qfrc_bias[0]), abs(shoulder.sum())
    print(f"{what}: joints in MuJoCo and Pinocchio {joints[what]}, torque of the first {np.round(torque_Nm[what], 2)} Nm")
assert list(joints.values()) == [(2, 2), (2, 2), (2, 0), (4, 2), (2, 1)]
assert np.allclose(torque_Nm["an arm"], 2.97, atol=0.01), torque_Nm
assert np.allclose(torque_Nm["an arm with its forearm in a frame"], (3.22, 1.50), atol=0.01)
PY
