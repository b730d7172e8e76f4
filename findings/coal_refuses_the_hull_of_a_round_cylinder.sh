#!/bin/sh
# coal 3.0.3: ConvexBase.convexHull and BVHModelBase.buildConvexHull of a cylinder as a mesh.
#
# Expected: the hull, whatever the number of sides.
# Seen: from 257 sides on, "Too many neighbors". Triangles are wanted ("Qt"), so an end of the cylinder
# becomes a fan around one of its corners, which then has all others as neighbours; coal counts them in
# eight bits. Without triangles (an empty qhull command) the same hull is made.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet coal==3.0.3 "numpy<3"
"$folder/venv/bin/python" - <<'PY'
import coal
import numpy as np


def corners(sides):
    turn = 2.0 * np.pi * np.arange(sides) / sides
    ends = [np.column_stack((np.cos(turn), np.sin(turn), np.full(sides, z))) for z in (-1.0, 1.0)]
    return np.concatenate(ends)


def hull(sides, triangles):
    points = coal.StdVec_Vec3s()
    for point in corners(sides):
        points.append(point)
    try:
        made = coal.ConvexBase.convexHull(points, triangles, "Qt" if triangles else "")
    except RuntimeError as error:
        return str(error).strip().splitlines()[-1]
    return f"{len(made.points())} corners"


for sides in (200, 300):
    print(f"{sides} sides: with triangles {hull(sides, True)}, without {hull(sides, False)}")
assert hull(200, True) == "400 corners"
assert "Too many neighbors" in hull(300, True)
assert hull(300, False) == "600 corners"
PY
