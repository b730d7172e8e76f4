"""Differential kinematics for jogging and dragging: joint velocities from a quadratic program.

``servo.py`` is one step, ``servo_qp.py`` its program on OSQP, ``task_velocity.py`` what the user
asks of the tool. Limits, collision distances and loads are constraints of every step.
"""
