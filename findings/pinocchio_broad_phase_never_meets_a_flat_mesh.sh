#!/bin/sh
# pin 4.1.0 with coal 3.0.3: computeCollisions with a broad phase, and a flat mesh.
#
# Expected: the verdict of computeCollisions without one: the box on the joint is in the triangle.
# Seen: a mesh that lies exactly in a plane of its own axes (a table, a wall, a face of a scan) is
# never met. Its bounding box has no volume, and the managers take that for "nothing there". 1 nm of
# thickness is enough.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pin==4.1.0 coal==3.0.3 "numpy<3"
"$folder/venv/bin/python" - <<'PY'
import coal
import numpy as np
import pinocchio as pin


def verdicts(bulge):
    model, bodies = pin.Model(), pin.GeometryModel()
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "joint")
    wall = coal.BVHModelOBBRSS()
    wall.beginModel(1, 3)
    wall.addVertices(np.array([[0.0, -1.0, -1.0], [0.0, 1.0, -1.0], [bulge, 0.0, 1.0]]))
    wall.addTriangles(np.array([[0, 1, 2]]))
    wall.endModel()
    here = pin.SE3.Identity()
    bodies.addGeometryObject(pin.GeometryObject("box", 1, here, coal.Box(0.1, 0.1, 0.1)))
    bodies.addGeometryObject(pin.GeometryObject("wall", 0, here, wall))
    bodies.addCollisionPair(pin.CollisionPair(0, 1))
    data, q = model.createData(), np.zeros(1)
    pairs = pin.GeometryData(bodies)
    manager = pin.BroadPhaseManager_NaiveCollisionManager(model, bodies, pairs)
    callback = pin.CollisionCallBackDefault(bodies, pairs, True)
    broad = pin.computeCollisions(model, data, manager, callback, q)
    return broad, pin.computeCollisions(model, data, bodies, pin.GeometryData(bodies), q, False)


for bulge in (0.0, 1e-9):
    broad, every = verdicts(bulge)
    print(f"out of plane by {bulge:g} m: broad phase {broad}, every pair {every}")
assert verdicts(0.0) == (False, True)
assert verdicts(1e-9) == (True, True)
PY
