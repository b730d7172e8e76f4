#!/bin/sh
# ahrs 0.4.0: Quaternion ** a, and the roll, pitch and yaw of its class DCM beside those of its class Quaternion.
#
# Expected: the power of a unit quaternion is the same turn by a times the angle, "cos(a theta), u sin(a theta)", as the
# documentation derives it; and one orientation has one roll, pitch and yaw in one package.
# Seen: the power is e to the power of each number by itself: q ** 0.5 is not of length 1, and brought to length 1 it is a turn
# by 120 degrees and more, whatever q was; for no turn at all as well. An orientation on the way between two others,
# a * (a' * b) ** t, is wrong everywhere. And DCM.to_rpy() are the angles of the inverse: 20, 30, 50 degrees come back as
# 9.8, -34.3, -47.6; for a turn about one axis only the sign is wrong.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet ahrs==0.4.0 "numpy<3"
"$folder/venv/bin/python" - <<'PY'
import math

import numpy as np
from ahrs import DCM, Quaternion

found = {}
for degrees in (0.0, 10.0, 56.0, 120.0):
    half = np.asarray(Quaternion(rpy=[0.0, 0.0, math.radians(degrees)]) ** 0.5)
    length = np.linalg.norm(half)
    found[degrees] = 2.0 * math.degrees(math.acos(half[0] / length))
    print(f"half of {degrees:.0f} deg about z: {half.round(3)}, of length {length:.3f}; with length 1 {found[degrees]:.0f} deg")
same = Quaternion(rpy=np.radians([20.0, 30.0, 50.0]))
by_quaternion, by_matrix = np.degrees(same.to_angles()), np.degrees(DCM(same.to_DCM()).to_rpy())
of_inverse = np.degrees(Quaternion(same.conj).to_angles())
print(f"roll, pitch, yaw by Quaternion {by_quaternion.round(1)}, DCM {by_matrix.round(1)}, inverse {of_inverse.round(1)}")
assert min(found.values()) > 100.0
assert np.allclose(by_quaternion, (20.0, 30.0, 50.0)) and np.allclose(by_matrix, of_inverse)
PY
