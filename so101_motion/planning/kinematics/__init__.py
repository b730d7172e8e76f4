"""Forward and inverse kinematics of the five-joint arm, and its workspace.

``model.py`` wraps Pinocchio. ``ik.py`` is the entry to inverse kinematics; its closed forms are in
``arm_geometry.py`` and ``planar_3r.py``, their batched forms in ``batch_ik.py``.
It may import ``planning.goals`` and ``common``.
"""
