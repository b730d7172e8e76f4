"""Forward and inverse kinematics of the five-joint arm, and its workspace.

``model.py`` wraps Pinocchio. ``ik.py`` is the entry to inverse kinematics; ``arm_geometry.py``
explains the closed forms, which are compiled, and in ``batch_ik.py`` for many poses at once.
It may import ``planning.goals`` and ``common``.
"""
