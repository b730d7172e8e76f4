#!/bin/sh
# modern-robotics 1.1.1: ScrewTrajectory and CartesianTrajectory between two poses that are half a turn apart, as when a gripper
# is turned over.
#
# Expected: the last pose of a trajectory is the goal; MatrixLog3 has a branch of its own for half turns.
# Seen: that branch asks for a trace of -1 or less, and rounding puts the trace of many half turns just above. Then the formula for
# other angles divides what is left of R - R' by the sine of almost pi. Of 200 half turns about the tool's axis, 38 end in an
# orientation that is not the goal's, and 25 screw motions are NaN. A thousandth of a degree beside half a turn all arrive.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet modern-robotics==1.1.1 "numpy<3"
"$folder/venv/bin/python" - 2>/dev/null <<'PY'
import math

import modern_robotics as mr
import numpy as np


def turn(axis, degrees):
    return mr.MatrixExp3(mr.VecToso3(np.eye(3)["xyz".index(axis)] * math.radians(degrees)))


counts = {}
for degrees in (180.0, 179.999):
    for motion in (mr.ScrewTrajectory, mr.CartesianTrajectory):
        random, elsewhere, nowhere = np.random.default_rng(0), 0, 0
        for _ in range(200):
            pan, lift, roll = random.uniform(-120.0, 120.0, 3)
            start = turn("z", pan) @ turn("y", lift) @ turn("x", roll)
            T_goal = mr.RpToTrans(start @ turn("x", degrees), [0.25, 0.1, 0.1])
            T_last = motion(mr.RpToTrans(start, [0.2, 0.0, 0.1]), T_goal, 2.0, 11, 5)[-1]
            error = np.abs(T_last - T_goal).max()
            elsewhere, nowhere = elsewhere + bool(error > 0.05), nowhere + bool(np.isnan(error))
        counts[degrees, motion.__name__] = elsewhere, nowhere
        print(f"{motion.__name__} over {degrees} deg: of 200 motions {elsewhere} end elsewhere, {nowhere} are NaN")
assert counts[180.0, "ScrewTrajectory"][0] > 15 and counts[180.0, "ScrewTrajectory"][1] > 5
assert counts[180.0, "CartesianTrajectory"][0] > 15
assert counts[179.999, "ScrewTrajectory"] == counts[179.999, "CartesianTrajectory"] == (0, 0)
PY
