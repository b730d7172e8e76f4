"""The API that programs call: an arm and a gripper to plan for, move, guide and stop.

``planning_process.py`` runs the planner in a process of its own, ``motion_queue.py`` lets a newer
motion supersede the one under way. It may import ``control``, ``files`` and what is below them.
"""
