"""From a path to a trajectory that keeps velocity, acceleration, jerk and torque limits.

``retime.py`` times a path with toppra's method and a jerk filter, ``online.py`` makes motions that
are needed at once with ruckig, ``verify.py`` measures every limit before anything is sent.
"""
