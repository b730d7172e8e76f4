"""trimesh, meshio, pymeshlab and VTK write the part."""

import sys

import meshio
import numpy as np
import pymeshlab
import trimesh
import vtk

folder = sys.argv[1]

L = [(0, 0), (40, 0), (40, 10), (10, 10), (10, 30), (0, 30)]
v = np.array([(x + 200, y, 0) for x, y in L] + [(x + 200, y, 20) for x, y in L], float)
cap = [(0, 5, 4), (0, 4, 3), (0, 3, 1), (1, 3, 2)]
f = [t for t in cap] + [(c + 6, b + 6, a + 6) for a, b, c in cap]
for i in range(6):
    j = (i + 1) % 6
    f += [(i, j, 6 + j), (i, 6 + j, 6 + i)]
f = np.array(f)
m = trimesh.Trimesh(v, f, process=False)
for n, k in (
    ("t.stl", {}),
    ("t_text.stl", dict(file_type="stl_ascii")),
    ("t.ply", {}),
    ("t_text.ply", dict(encoding="ascii")),
    ("t.obj", {}),
    ("t.off", {}),
):
    m.export(f"{folder}/trimesh_{n}", **k)
g = m.copy()
g.apply_scale(0.001)
g.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))
g.export(f"{folder}/trimesh.glb")
q = [[i, (i + 1) % 6, 6 + (i + 1) % 6, 6 + i] for i in range(6)]
mm = meshio.Mesh(v, [("triangle", f[:8]), ("quad", np.array(q))])
meshio.write(f"{folder}/meshio.ply", mm, binary=True)
meshio.write(f"{folder}/meshio_text.ply", mm, binary=False)
meshio.write(f"{folder}/meshio.obj", mm)
meshio.write(f"{folder}/meshio.stl", meshio.Mesh(v, [("triangle", f)]), binary=True)
meshio.write(f"{folder}/meshio_text.stl", meshio.Mesh(v, [("triangle", f)]))
ms = pymeshlab.MeshSet()
ms.add_mesh(pymeshlab.Mesh(v, f.astype("i4")), "vertex group")
for n, k in (
    ("a.stl", {}),
    ("b.stl", dict(binary=False)),
    ("a.ply", {}),
    ("b.ply", dict(binary=False)),
    ("a.obj", {}),
    ("a.off", {}),
    ("a.3mf", {}),
):
    try:
        ms.save_current_mesh(f"{folder}/pymeshlab_{n}", **k)
    except Exception as e:
        print(n, e)
P = vtk.vtkPoints()
[P.InsertNextPoint(*x) for x in v]
C = vtk.vtkCellArray()
for p in [[1, 0, 5, 4, 3, 2], [7, 8, 9, 10, 11, 6], *q]:
    C.InsertNextCell(len(p))
    [C.InsertCellPoint(i) for i in p]
d = vtk.vtkPolyData()
d.SetPoints(P)
d.SetPolys(C)
tr = vtk.vtkTriangleFilter()
tr.SetInputData(d)
for W, n, src in (
    (vtk.vtkPLYWriter, "vtk.ply", d),
    (vtk.vtkOBJWriter, "vtk.obj", d),
    (vtk.vtkSTLWriter, "vtk.stl", None),
    (vtk.vtkSTLWriter, "vtk_b.stl", None),
    (vtk.vtkPLYWriter, "vtk_text.ply", d),
):
    w = W()
    w.SetFileName(f"{folder}/{n}")
    (w.SetInputConnection(tr.GetOutputPort()) if src is None else w.SetInputData(src))
    if n == "vtk_b.stl":
        w.SetFileTypeToBinary()
    if n == "vtk_text.ply":
        w.SetFileTypeToASCII()
    w.Write()
