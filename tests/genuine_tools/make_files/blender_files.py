"""Blender writes the part, its numbers in millimetres (1) or metres (0.001)."""

import sys

import bpy

folder = sys.argv[1]
S = float(sys.argv[2])
bpy.ops.wm.read_factory_settings(use_empty=True)
L = [(0, 0), (40, 0), (40, 10), (10, 10), (10, 30), (0, 30)]
v = [(x * S, y * S, 0) for x, y in L] + [(x * S, y * S, 20 * S) for x, y in L]
f = [[1, 0, 5, 4, 3, 2], [7, 8, 9, 10, 11, 6]] + [
    [i, (i + 1) % 6, 6 + (i + 1) % 6, 6 + i] for i in range(6)
]
m = bpy.data.meshes.new("facet")
m.from_pydata(v, [], f)
o = bpy.data.objects.new("facet", m)
bpy.context.collection.objects.link(o)
o.location = (200 * S, 0, 0)
o.select_set(True)
bpy.context.view_layer.objects.active = o
p = f"{folder}/blender_{'m' if S < 1 else 'mm'}"
bpy.ops.wm.stl_export(filepath=p + ".stl")
bpy.ops.wm.stl_export(filepath=p + "_text.stl", ascii_format=True)
bpy.ops.wm.ply_export(filepath=p + ".ply")
bpy.ops.wm.ply_export(filepath=p + "_text.ply", ascii_format=True)
bpy.ops.wm.obj_export(filepath=p + ".obj", forward_axis="Y", up_axis="Z")
try:
    bpy.ops.export_scene.gltf(filepath=p + ".glb")
except Exception as e:
    print("glb", e)
