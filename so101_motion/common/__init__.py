"""What every other package may use: errors, geometry, units, clock, joint state, settings, modes.

It imports nothing of this project outside this folder. It opens no port and no file of the user.
"""
