"""The 3D scene: the arm, its ghost, obstacles, the planned path, camera and lights.

May import ``page`` and the package.
"""
