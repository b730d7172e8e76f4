"""Six Feetech servos as one joint driver: connection, health, compensation, hand guiding.

``feetech_arm.py`` is the driver; the other files are its parts. It may import ``drivers.bus``.
"""
