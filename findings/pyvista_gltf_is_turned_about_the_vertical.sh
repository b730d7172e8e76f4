#!/bin/sh
# pyvista 0.49.1 (VTK 9.7.2): Plotter.export_gltf, read back by trimesh 5.2.0.
#
# Expected: with rotate_scene=True, "rotate scene to be compatible with the glTF specifications" (y up),
# a reader that turns y up back to z up, (x, y, z) -> (x, -z, y), gets the part where it was, as with
# trimesh's or Blender's export.
# Seen: z is up again, but the part has been turned by 90 degrees about the vertical as well: x -> -y,
# y -> x. A wall in front of a robot stands beside it. With rotate_scene=False z stays up in the file,
# against the standard. Either way numbers are written as they are (millimetres stay millimetres,
# glTF is in metres).
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyvista==0.49.1 vtk==9.7.2 trimesh==5.2.0 networkx
"$folder/venv/bin/python" - "$folder/part.gltf" <<'PY'
import sys

import numpy as np
import pyvista
import trimesh

part = pyvista.Cube(center=(0.2, 0.01, 0.03), x_length=0.1, y_length=0.06, z_length=0.04)
ends = {}
for turned in (True, False):
    plotter = pyvista.Plotter(off_screen=True)
    plotter.add_mesh(part.triangulate())
    plotter.export_gltf(sys.argv[1], rotate_scene=turned)
    vertices = trimesh.load_scene(sys.argv[1]).to_mesh().vertices
    z_up = vertices[:, [0, 2, 1]] * (1.0, -1.0, 1.0)
    ends[turned] = z_up.mean(axis=0)
    print(f"rotate_scene={turned}: centre with z up again {ends[turned].round(3)}, was 0.2 0.01 0.03")
assert np.allclose(ends[True], (0.01, -0.2, 0.03), atol=1e-6)
assert np.allclose(ends[False], (0.2, -0.03, 0.01), atol=1e-6)
PY
