"""Tasks of an arm: programs of waypoints, guided paths, teleoperation, LeRobot's data sets.

Each is a folder of its own. It may import ``rig`` and what is below it.
"""
