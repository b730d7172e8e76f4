"""Calibration: the record of where each joint's zero and stops are, and how it is made."""
