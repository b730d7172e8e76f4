"""Tasks of an arm: programs, guided paths, teleoperation, LeRobot's data sets, and sweeps.

Each is a folder of its own. It may import ``rig`` and what is below it.
"""
