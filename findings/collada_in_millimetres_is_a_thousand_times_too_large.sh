#!/bin/sh
# coal 3.0.3, yourdfpy 0.0.60, trimesh 5.2.0: a Collada file (.dae) whose <asset> says <unit meter="0.001">, as CAD programs
# write it that work in millimetres; a block of 20 x 40 x 60.
#
# Expected: the block is 20 x 40 x 60 mm; Collada defines what the unit is for.
# Seen: in coal, as a mesh of a URDF in yourdfpy, and in trimesh it is 20 x 40 x 60 m, and nothing is said. trimesh notes the
# unit beside the mesh, and makes millimetres of it if it is asked to (convert_units); the other two forget it. The same
# with inches. As an obstacle it holds the whole arm.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet coal==3.0.3 yourdfpy==0.0.60 trimesh==5.2.0 pycollada==0.9.3 "numpy<3"
cd "$folder"
"$folder/venv/bin/python" - <<'PY'
import coal
import numpy as np
import trimesh
import yourdfpy
from collada import Collada, geometry, scene, source

SIZE = np.array([20.0, 40.0, 60.0])


def write(name, unit):
    block, file = trimesh.creation.box(SIZE), Collada()
    file.assetInfo.unitmeter, file.assetInfo.unitname, file.assetInfo.upaxis = unit, name[:-4], "Z_UP"
    points = source.FloatSource("points", block.vertices.ravel(), ("X", "Y", "Z"))
    shape, given = geometry.Geometry(file, "block", "block", [points]), source.InputList()
    given.addInput(0, "VERTEX", "#points")
    shape.primitives.append(shape.createTriangleSet(block.faces.ravel(), given, "grey"))
    file.geometries.append(shape)
    file.scene = scene.Scene("scene", [scene.Node("node", children=[scene.GeometryNode(shape, [])])])
    file.scenes.append(file.scene)
    file.write(name)


for name, unit in (("millimetres.dae", 0.001), ("inches.dae", 0.0254)):
    write(name, unit)
    with open(name) as file:
        assert f'meter="{unit}"' in file.read()
    in_coal = coal.MeshLoader().load(name, np.ones(3))
    in_coal.computeLocalAABB()
    with open("robot.urdf", "w") as file:
        mesh = f'<geometry><mesh filename="{name}"/></geometry>'
        file.write(f'<robot name="r"><link name="a"><visual>{mesh}</visual></link></robot>')
    loaded = trimesh.load(name, force="mesh")
    sizes = {
        "coal": np.asarray(in_coal.aabb_local.max_) - np.asarray(in_coal.aabb_local.min_),
        "yourdfpy": yourdfpy.URDF.load("robot.urdf").scene.extents,
        "trimesh": loaded.extents.copy(),
        "trimesh, asked to convert": loaded.convert_units("meters").extents,
    }
    for program, size in sizes.items():
        print(f"{name}, {program}: {np.round(size, 4).tolist()} m")
        right = SIZE * unit if program.endswith("convert") else SIZE
        assert np.allclose(size, right, rtol=1e-6)
PY
