"""The panels and tabs around the scene: joints, moving, jogging, poses, plots, health, sharing.

May import ``page``, ``scene``, ``server``, ``view_model`` and the package.
"""
