#!/bin/sh
# meshio 5.3.5: meshio.read of a Wavefront OBJ file whose faces count back from the last vertex.
#
# Expected: "f -3 -2 -1" after three vertices is the triangle of these three, as the format defines it; the same file
# with "f 1 2 3" and "f 4 5 6" gives the same mesh.
# Seen: 1 is subtracted from every index, also from negative ones, which numpy then counts from the end of the whole
# file: -3 -2 -1 becomes -4 -3 -2. Both parts become one triangle between them; no error, no warning.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet meshio==5.3.5
cd "$folder"
"$folder/venv/bin/python" - <<'PY'
import meshio
import numpy as np

PARTS = ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf {}\n", "v 5 0 0\nv 6 0 0\nv 5 1 0\nf {}\n")


def greatest_x(*faces):
    with open("parts.obj", "w", encoding="utf-8") as file:
        file.write("".join(part.format(face) for part, face in zip(PARTS, faces)))
    mesh = meshio.read("parts.obj")
    a, b, c = (mesh.points[mesh.cells_dict["triangle"][:, i]] for i in range(3))
    return np.array([a, b, c]).max(axis=0)[:, 0]


absolute, relative = greatest_x("1 2 3", "4 5 6"), greatest_x("-3 -2 -1", "-3 -2 -1")
print(f"greatest x of each part with absolute indices {absolute}, with relative ones {relative}")
assert absolute.tolist() == [1.0, 6.0]
assert relative.tolist() == [6.0, 6.0]
PY
