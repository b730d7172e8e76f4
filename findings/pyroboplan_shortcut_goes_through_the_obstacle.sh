#!/bin/sh
# pyroboplan 1.3.1 on pin 4.1.0: planning.path_shortcutting.shortcut_path. No model of it is loaded: a ball on two
# prismatic joints goes round a post.
#
# Expected: a path free of collisions becomes a shorter one that is free, too: "verifying whether those two points can
# be connected directly without collisions".
# Seen: the points that were connected are a and b, but what is kept runs from the waypoint before a straight to b, and
# nobody checked that (a is written into the list and cut off again). For each of 100 seeds the path that comes back goes
# through the post; the library's own check tells so, with the step that shortcut_path was given. The caller's list is
# changed as well, so the path that was free is gone.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pin==4.1.0 "numpy<3"
"$folder/venv/bin/pip" install --quiet --no-deps pyroboplan==1.3.1
"$folder/venv/bin/python" - <<'PY'
import coal
import numpy as np
import pinocchio as pin
from pyroboplan.core.utils import check_collisions_along_path
from pyroboplan.planning.path_shortcutting import shortcut_path
from pyroboplan.planning.utils import discretize_joint_space_path

STEP, HERE = 0.05, pin.SE3.Identity()
model, bodies = pin.Model(), pin.GeometryModel()
x = model.addJoint(0, pin.JointModelPX(), HERE, "x")
y = model.addJoint(x, pin.JointModelPY(), HERE, "y")
bodies.addGeometryObject(pin.GeometryObject("ball", y, HERE, coal.Sphere(0.02)))
bodies.addGeometryObject(pin.GeometryObject("post", 0, HERE, coal.Box(0.6, 0.6, 0.6)))
bodies.addCollisionPair(pin.CollisionPair(0, 1))


def touches(path):
    return check_collisions_along_path(model, bodies, discretize_joint_space_path(path, STEP))


def round_the_post():
    return [np.array(point) for point in ([-1.0, 0.0], [-0.5, 0.5], [0.5, 0.5], [1.0, 0.0])]


through, changed = 0, 0
for seed in range(100):
    np.random.seed(seed)
    path = round_the_post()
    through += touches(shortcut_path(model, bodies, path, max_step_size=STEP))
    changed += any((one != other).any() for one, other in zip(path, round_the_post()))
print(f"given: touches the post {touches(round_the_post())}; of 100 shortened ones {through} go through it")
print(f"the caller's list was changed by {changed} of 100 calls")
assert not touches(round_the_post())
assert through > 90 and changed > 90
PY
