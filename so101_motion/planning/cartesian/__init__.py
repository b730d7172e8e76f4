"""Lines and arcs of the tool, followed by five joints within a tolerance.

``cartesian.py`` runs it: candidate configurations along the tool path, the best sequence through
them (a ladder graph, as in Descartes), and a smooth joint curve through that.
"""
