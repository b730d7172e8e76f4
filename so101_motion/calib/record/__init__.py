"""The calibration record: its file, its versions, LeRobot's format, and each joint's zero."""
