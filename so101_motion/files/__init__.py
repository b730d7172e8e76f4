"""The user's own files: saved poses, scenes, exported trajectories, and writing files safely.

It may import ``planning``, ``drivers`` and ``common``. What a calibration file means is in
``calib``; programs and guided paths are kept beside what runs them, in ``tasks``.
"""
