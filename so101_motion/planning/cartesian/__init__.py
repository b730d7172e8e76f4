"""Cartesian paths: follow lines and arcs of the tool with five joints, within a tolerance.

``cartesian.py`` runs it: candidate configurations along the tool path, the best sequence through
them (a ladder graph, as in Descartes), and a smooth joint curve through that.
"""
