#!/bin/sh
# klampt 0.10.1.post1: klampt.model.trajectory.path_to_trajectory(path, vmax=..., amax=...), with what its documentation
# recommends for limits (velocities="auto", timing="limited", which is what it does by itself).
#
# Expected, as it promises: a finely sampled trajectory that "respects the limits defined in the arguments".
# Seen: from sample to sample it does, but the velocity that each sample states is up to 2.7 times that, because it was not
# scaled with the time. The result is a Hermite trajectory, so what lies between two samples is shaped by these velocities:
# asked for a goal every millisecond, as a controller does, one joint that shall go from 0 to 3 rad with at most 1 rad/s goes with
# 2.5 rad/s at each sample and almost stands between them, 38 times a second. With velocities="minimum-jerk" it goes back by up to
# 1.3 rad/s between them. smoothing=None has no such velocities, and does not shake.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet klampt==0.10.1.post1 "numpy<3"
"$folder/venv/bin/python" - <<'PY'
import numpy as np
from klampt.model.trajectory import path_to_trajectory

found = []
for what in ({}, {"velocities": "minimum-jerk"}, {"smoothing": None}):
    motion = path_to_trajectory([[0.0], [1.0], [2.0], [3.0]], vmax=[1.0], amax=[4.0], **what)
    samples, sampled_at = np.array(motion.milestones), np.array(motion.times)
    between = np.diff(samples[:, 0]) / np.diff(sampled_at)
    goals = np.array([motion.eval(t)[0] for t in np.arange(0.0, sampled_at[-1], 0.001)])
    speed = np.diff(goals) / 0.001
    found.append((between.max(), samples[:, 1:].max(initial=0.0), speed.min(), speed.max()))
    print("{}: {:.2f} rad/s from sample to sample, stated {:.2f}; every ms {:+.2f} to {:+.2f}".format(what, *found[-1]))
auto, minimum_jerk, unsmoothed = found
assert auto[0] < 1.02 and auto[1] > 2.5 and auto[2] < 0.1 and auto[3] > 2.4
assert minimum_jerk[0] < 1.02 and minimum_jerk[2] < -1.0 and minimum_jerk[3] > 1.9
assert unsmoothed[2] > 0.0 and unsmoothed[3] < 1.02
PY
