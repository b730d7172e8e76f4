"""Steps of a jog or of a following: joint velocities that keep limits, clearance and load.

``tool_reference.py`` leads the joints of a jog: ``task_velocity.py`` converts a twist, a pose or a
point into joint velocities. ``guard.py`` finds the nearest step that keeps its bounds, and proves
short paths free.
"""
