"""Collision checking: the scene, and whether a configuration or a motion touches anything.

``scene.py`` is the scene as plain values, ``collision.py`` checks one configuration with coal,
``continuous_check.py`` proves a whole joint motion free. It may import ``planning.kinematics``.
"""
