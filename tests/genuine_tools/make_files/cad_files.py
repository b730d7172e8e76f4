"""CadQuery or build123d writes the part."""

import sys

folder, which = sys.argv[1:3]
L = [(0, 0), (40, 0), (40, 10), (10, 10), (10, 30), (0, 30)]
if which == "cq":
    import cadquery as cq

    b = cq.Workplane().polyline(L).close().extrude(20)
    s = b.translate((200, 0, 0))
    cq.exporters.export(s, f"{folder}/cadquery.stl")
    cq.Assembly(b, loc=cq.Location((200, 0, 0))).export(f"{folder}/cadquery_mm.glb")
    try:
        cq.exporters.export(s, f"{folder}/cadquery.3mf")
    except Exception as e:
        print(e)
else:
    from build123d import Mesher, Polyline, Pos, export_gltf, export_stl, extrude, make_face

    b = Pos(200, 0, 0) * extrude(make_face(Polyline(*L, close=True)), 20)
    export_stl(b, f"{folder}/build123d.stl")
    export_stl(b, f"{folder}/build123d_text.stl", ascii_format=True)
    export_gltf(b, f"{folder}/build123d.glb", binary=True)
    m = Mesher()
    m.add_shape(b)
    m.write(f"{folder}/build123d.3mf")
