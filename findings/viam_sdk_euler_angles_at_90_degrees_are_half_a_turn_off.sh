#!/bin/sh
# viam-sdk 0.85.1: rotations to Euler angles or axis-angle and back, with its own viam.spatialmath.
#
# Expected: the same rotation (at a pitch of 90 degrees yaw and roll are not unique, but their rotation is).
# Seen: at a pitch of exactly +-90 degrees 80 of 200 rotations come back wrong, by up to half a turn; 0.001 degrees beside it
# all are right. The identity becomes a turn by 0 about z, and that a quaternion of NaN.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet viam-sdk==0.85.1 scipy==1.17.1
"$folder/venv/bin/python" - <<'PY'
import math

import numpy as np
from scipy.spatial.transform import Rotation
from viam.spatialmath import Quaternion

random = np.random.default_rng(0)


def error_deg(rotation, back):
    return math.degrees((rotation.inv() * Rotation.from_quat([back.i, back.j, back.k, back.w])).magnitude())


def wrong(pitch_deg):
    found = 0
    for _ in range(200):
        rotation = Rotation.from_euler("ZYX", [random.uniform(-180, 180), pitch_deg, random.uniform(-180, 180)], degrees=True)
        x, y, z, w = rotation.as_quat()
        found += error_deg(rotation, Quaternion(w, x, y, z).to_euler_angles().to_quaternion()) > 1.0
    return found


counts = {pitch: wrong(pitch) for pitch in (89.999, 90.0, -90.0, 30.0)}
same = Quaternion(1.0, 0.0, 0.0, 0.0).to_axis_angle().to_quaternion()
norm = math.hypot(same.w, same.i, same.j, same.k)
print(f"of 200 rotations at each pitch, this many come back wrong: {counts}; the identity with the norm {norm}")
assert counts[89.999] == counts[30.0] == 0
assert min(counts[90.0], counts[-90.0]) > 20
assert not norm > 0.0
PY
