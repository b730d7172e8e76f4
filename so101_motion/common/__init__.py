"""Types that every other package uses: errors, geometry, units, clock, joint state, modes.

Everything here is small and free of I/O. It imports nothing of this project outside this folder.
"""
