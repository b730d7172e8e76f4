#!/bin/sh
# python-fcl 0.7.0.11: fcl.continuousCollide, with the solver that a request has as it comes (conservative advancement).
#
# Expected: whether a box is given as fcl.Box or as a mesh of twelve triangles, it is found to hit a plate that it is pushed
# through, at the same time.
# Seen: for 30 straight pushes the boxes are found to collide each time, at the right moment; the meshes never: 1.0, which
# means "free all the way". The same meshes do collide in the middle of the way if fcl.collide is asked there, and they
# are found with CCDC_NAIVE and many iterations. Meshes are what robots and obstacles are made of mostly.
# With CCDM_SCREW, whose screw without a turn is the same push, boxes are found, but up to 0.1 of the way too late.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet python-fcl==0.7.0.11 "numpy<3"
"$folder/venv/bin/python" - <<'PY'
import itertools

import fcl
import numpy as np

SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
TRIANGLES = np.array([three for a, b, c, d in SIDES for three in ((a, b, c), (a, c, d))])


def mesh(*size):
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * size
    model = fcl.BVHModel()
    model.beginModel(len(corners), len(TRIANGLES))
    model.addSubModel(corners, TRIANGLES)
    model.endModel()
    return model


def contact(make, start, end, **how):
    """Which part of the way is free, 1 for all of it; and whether both collide with the box halfway."""
    box, plate = fcl.CollisionObject(make(0.1, 0.06, 0.04)), fcl.CollisionObject(make(0.02, 0.3, 0.3))
    box.setTransform(fcl.Transform((start + end) / 2))
    halfway = fcl.collide(box, plate) > 0
    box.setTransform(fcl.Transform(start))
    request, result = fcl.ContinuousCollisionRequest(**how), fcl.ContinuousCollisionResult()
    return fcl.continuousCollide(box, fcl.Transform(end), plate, fcl.Transform(), request, result), halfway


random, ways = np.random.default_rng(0), {}
for _ in range(30):
    start, end = np.array([[-0.4, *random.uniform(-0.1, 0.1, 2)], [0.4, *random.uniform(-0.1, 0.1, 2)]])
    for name, make, how in (
        ("boxes", fcl.Box, {}),
        ("boxes, screw", fcl.Box, {"ccd_motion_type": fcl.CCDMotionType.CCDM_SCREW}),
        ("meshes", mesh, {}),
        ("meshes, naive", mesh, {"ccd_solver_type": fcl.CCDSolverType.CCDC_NAIVE, "num_max_iterations": 1000}),
    ):
        free, halfway = contact(make, start, end, **how)
        assert halfway
        ways.setdefault(name, []).append(free)
right = (0.4 - 0.05 - 0.01) / 0.8
for name, free in ways.items():
    print(f"{name}: free for {min(free):.3f} to {max(free):.3f} of the way, {right:.3f} is right")
assert np.allclose(ways["boxes"], right, atol=2e-3) and np.allclose(ways["meshes, naive"], right, atol=2e-3)
assert ways["meshes"] == [1.0] * 30
assert max(ways["boxes, screw"]) > right + 0.03
PY
