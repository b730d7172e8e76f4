"""Steps of a jog or of a following: joint velocities that keep limits, clearance and load.

``servo.py`` computes a step of a jog: joint velocities for a twist, a pose or a point, and
``servo_qp.py`` finds the nearest ones that keep the bounds, with OSQP.
``guard.py`` proves short paths free, for jogs and for followings; it finds the nearest
step of a following that keeps its bounds.
"""
