"""The driver of the arm: serial port, servo bus, joint driver, and the servo emulator.

Registers, ticks and bytes stay in here. It knows no kinematics: gravity comes in as a function. It
may import ``common`` only.
"""
