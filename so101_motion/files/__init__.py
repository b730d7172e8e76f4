"""The user's files: saved poses, scenes, exported trajectories; and safe writing of files.

It may import ``planning``, ``drivers`` and ``common``. What a calibration file means is in
``calib``; programs and guided paths are kept beside what runs them, in ``tasks``.
"""
