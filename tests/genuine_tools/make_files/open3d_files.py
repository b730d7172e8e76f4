"""Open3D writes the part, and points of its surface in metres."""

import sys

import open3d as o3d

folder = sys.argv[1]

m = o3d.io.read_triangle_mesh(f"{folder}/trimesh_t.ply")
m.compute_vertex_normals()
m.compute_triangle_normals()
for n, k in (
    ("o3d.stl", {}),
    ("o3d.ply", {}),
    ("o3d_text.ply", dict(write_ascii=True)),
    ("o3d.obj", {}),
    ("o3d.off", {}),
):
    print(n, o3d.io.write_triangle_mesh(f"{folder}/{n}", m, **k))
c = m.scale(0.001, (0, 0, 0)).sample_points_uniformly(500)
for n, k in (
    ("o3d.pcd", {}),
    ("o3d_text.pcd", dict(write_ascii=True)),
    ("o3d_packed.pcd", dict(compressed=True)),
    ("o3d_cloud.ply", {}),
    ("o3d.xyz", {}),
):
    print(n, o3d.io.write_point_cloud(f"{folder}/{n}", c, **k))
