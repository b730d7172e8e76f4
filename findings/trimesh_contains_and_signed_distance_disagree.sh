#!/bin/sh
# trimesh 5.2.0: Trimesh.contains and trimesh.proximity.signed_distance, on one mesh of two boxes that overlap,
# as a CAD program exports an assembly.
#
# Expected: both say whether a point is inside (signed_distance: positive inside), or is_volume is False.
# Seen: is_volume is True. Of points inside both boxes contains takes a good part for outside, because it counts crossings of
# a ray (2, so even); and another part when it is asked again. signed_distance finds nearly all inside. volume
# counts the common part twice. As an obstacle for a robot the middle of the part would be free space, mostly.
# Each part of mesh.split() by itself is right.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet trimesh==5.2.0 rtree==1.4.1 scipy==1.17.1 networkx "numpy<3"
"$folder/venv/bin/python" - <<'PY'
import numpy as np
import trimesh

box = trimesh.creation.box((0.1, 0.1, 0.1))
other = box.copy()
other.apply_translation((0.05, 0.0, 0.0))
mesh = trimesh.util.concatenate([box, other])
points = np.random.default_rng(0).uniform((0.005, -0.04, -0.04), (0.045, 0.04, 0.04), (300, 3))  # in both boxes
first, second, distance = mesh.contains(points), mesh.contains(points), trimesh.proximity.signed_distance(mesh, points)
print(f"contains: {first.sum()} of 300 inside, asked again {second.sum()}; signed_distance: {(distance > 0.0).sum()}")
print("is_volume:", mesh.is_volume, "volume:", round(1e6 * mesh.volume), "cm^3 (1500 would be right)")
assert mesh.is_volume and abs(1e6 * mesh.volume - 2000.0) < 1.0
assert first.sum() < 250 and (distance > 0.0).sum() > 290
assert all(part.contains(points).all() for part in mesh.split())
PY
