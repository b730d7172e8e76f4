"""The user's files: poses, scenes, cells, trajectories, failure records; and safe writing.

It may import ``planning``, ``drivers`` and ``common``. The content of a calibration file is read in
``calib``; programs and guided paths are read in ``tasks``, where they are run.
"""
