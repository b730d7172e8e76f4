#!/bin/sh
# roboplan 0.7.0: PathParameterizerTOPPRA with SplineFittingMode.Cubic or Adaptive, the two that do not stop at every waypoint.
#
# Expected: both "can deviate from the path", so what they make is checked, and where it is not valid the mode that stops at each
# waypoint takes over: no sample is one that the scene itself calls invalid.
# Seen: only collisions are checked. Two joints with limits of 1.5 rad go along two sides of a square, through waypoints 0.1 rad within
# the limits: Cubic turns a joint to 1.67 rad and Adaptive, too; for seven samples of ten isValidConfiguration says False. Velocities
# and accelerations are within theirs. Hermite and LinearBlend stay at 1.4 rad.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet roboplan==0.7.0 "numpy<3"
cat > "$folder/limits.yaml" <<'YAML'
joint_limits:
  first:
    max_acceleration: [4.0]
  second:
    max_acceleration: [4.0]
YAML
"$folder/venv/bin/python" - "$folder/limits.yaml" <<'PY'
import sys

import numpy as np
from roboplan import core
from roboplan.toppra import PathParameterizerTOPPRA, SplineFittingMode, TOPPRAOptions

link = '<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
joint = (
    '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><axis xyz="{}"/>'
    '<limit lower="-1.5" upper="1.5" effort="10" velocity="1"/></joint>'
)
urdf = '<robot name="two_joints">{}</robot>'.format(
    "".join(map(link.format, ("base", "upper", "fore")))
    + joint.format("first", "base", "upper", "0 0 1")
    + joint.format("second", "upper", "fore", "0 1 0")
)
scene = core.Scene("two joints", core.loadUrdfSceneDescriptionFromXml(urdf))
scene.importJointLimitsFromConfig(core.loadJointLimitsConfig(sys.argv[1]))
path = core.JointPath()
path.joint_names = scene.getJointNames()
path.positions = [np.array(q) for q in ((-1.4, -1.4), (1.4, -1.4), (1.4, 1.4))]
furthest, invalid = {}, {}
for mode in SplineFittingMode:
    timed = PathParameterizerTOPPRA(scene).generate(path, TOPPRAOptions(mode=mode))
    q = np.array(timed.positions)
    furthest[mode.name] = np.abs(q).max()
    invalid[mode.name] = np.mean([not scene.isValidConfiguration(each) for each in q])
    assert np.abs(timed.velocities).max() < 1.03
    print(f"{mode.name}: at most {furthest[mode.name]:.3f} rad of 1.5; {invalid[mode.name]:.0%} of the samples are not valid")
for name in ("Cubic", "Adaptive"):
    assert furthest[name] > 1.6 and invalid[name] > 0.5
for name in ("Hermite", "LinearBlend"):
    assert furthest[name] < 1.41 and invalid[name] == 0.0
PY
