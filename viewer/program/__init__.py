"""The Program tab: waypoints that are recorded, ordered, planned and run.

May import ``page``, ``scene``, ``view_model`` and the package.
"""
