"""Steps of a jog or of a following: joint velocities that keep limits, clearance and load.

``servo.py`` computes a step of a jog; ``task_velocity.py`` converts a twist, a pose or a point into
joint velocities for it. ``guard.py`` proves short paths free, for jogs and for followings, and
finds the nearest step that keeps its bounds.
"""
