"""Differential kinematics for jogging and following: joint velocities from a quadratic program.

``servo.py`` computes one step, ``servo_qp.py`` solves its program with OSQP, ``task_velocity.py``
turns the user's wish into joint velocities. Limits, collision distances and loads are constraints
of every step. ``guard.py`` proves short paths free; following of targets uses it, too.
"""
