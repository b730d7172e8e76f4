"""Turn a path into a trajectory that keeps velocity, acceleration, jerk and torque limits.

``retime.py`` times a path with toppra's method and a jerk filter, ``online.py`` computes motions
within a control tick with ruckig, ``verify.py`` checks every limit before anything is sent.
"""
