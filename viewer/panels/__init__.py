"""The panels around the scene: the arm with Stop, moving, poses, plots, health, sharing.

May import ``page``, ``scene``, ``server``, ``view_model`` and the package.
"""
