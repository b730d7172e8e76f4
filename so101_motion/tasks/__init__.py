"""What an arm does for a while: programs of waypoints, guided paths, teleoperation.

Each is a folder of its own. It may import ``rig`` and what is below it.
"""
