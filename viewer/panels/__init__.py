"""The panels and tabs around the scene: joints, Move, Jog, poses, plots, health, camera, Share.

May import ``page``, ``scene``, ``server``, ``view_model`` and the package.
"""
