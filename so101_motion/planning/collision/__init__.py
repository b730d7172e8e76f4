"""Collision checking: the scene, and whether a configuration or a motion touches anything.

``scene.py`` is the scene as plain values; ``collision.py`` checks configurations and proves whole
joint motions free. It may import ``planning.kinematics``.
"""
