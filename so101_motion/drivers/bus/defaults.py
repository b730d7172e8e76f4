"""Default settings of an arm's servo bus: baud rate, timeout and servo ids."""

BAUDRATE = 1_000_000
"""Bits per second of the servos as new; the published module's default."""

TIMEOUT = 1.0
"""How long silent servos are asked again at the start [s]; the published module's default."""

SERVO_IDS = (1, 2, 3, 4, 5)
"""The arm's servos, base to wrist."""

GRIPPER_ID = 6
"""The jaw's servo."""
