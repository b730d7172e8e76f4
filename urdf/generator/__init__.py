"""How the meshes are made: solids laid out from a table of figures, then shaded and written.

Build time only: needs manifold3d (a development dependency). Inside this folder lengths are
**millimetres**, as on a drawing; ``glb.py`` turns them into metres when it writes the file.
"""
