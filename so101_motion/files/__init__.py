"""The user's files: saved poses, scenes, exported trajectories; and safe writing of files.

It may import ``planning``, ``drivers`` and ``common``. The content of a calibration file is read in
``calib``; programs and guided paths are read in ``tasks``, where they are run.
"""
