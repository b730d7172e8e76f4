"""Calibration and motor setup: the record of zeros and stops, and how it is made.

``record`` is the file and what it means, ``procedure`` the calibration as a state machine,
``motors`` the setup of single servos. All of it talks to servos through ``access.py`` alone. It may
import ``files``, ``control``, ``planning``, ``drivers`` and ``common``.
"""
