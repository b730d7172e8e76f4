"""The driver of the arm: serial port, servo bus, joint driver, and the servo emulator.

Registers, ticks and bytes are known only here. Kinematics are not: callers pass gravity as a
function. It may import ``common`` only.
"""
