"""What turns joint setpoints into movement: serial port, servo bus, the arm's driver, the emulator.

Registers, ticks and bytes stay in here. It knows no kinematics: gravity comes in as a function. It
may import ``common`` only.
"""
