#!/bin/sh
# roboticstoolbox-python 1.5.0: mstraj(waypoints, dt, tacc, qdmax), multi-segment joint trajectories.
#
# Expected: no joint is faster than qdmax, whatever the blend time tacc.
# Seen: with tacc = 0 that holds; with a blend time, which is what makes the trajectory usable, joints are up to
# 36 % faster than qdmax near the waypoints. And the first row is not the first waypoint but the sample after it.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet roboticstoolbox-python==1.5.0
"$folder/venv/bin/python" - <<'PY'
import numpy as np
import roboticstoolbox as rtb

waypoints, dt = np.array([[0.0, 0.0], [1.0, 0.2], [1.0, 1.0], [0.2, 0.3]]), 0.01
fastest = {}
for tacc in (0.0, 0.1, 0.3):
    q = rtb.mstraj(waypoints, dt=dt, tacc=tacc, qdmax=[1.0, 1.0]).q
    fastest[tacc] = np.abs(np.diff(q, axis=0)).max() / dt
    print(f"blend {tacc} s: fastest joint {fastest[tacc]:.2f} rad/s with qdmax 1.00; first row {q[0]}")
    assert not np.array_equal(q[0], waypoints[0])
assert fastest[0.0] < 1.001 and fastest[0.1] > 1.3 and fastest[0.3] > 1.25
PY
