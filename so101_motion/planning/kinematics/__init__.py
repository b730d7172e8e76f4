"""Forward and inverse kinematics of the five-joint arm, and its workspace.

``model.py`` wraps Pinocchio. ``ik.py`` is where inverse kinematics is called; the closed forms
behind it are in ``arm_geometry.py`` and ``planar_3r.py``, their batched forms in ``batch_ik.py``.
It may import ``planning.goals`` and ``common``.
"""
