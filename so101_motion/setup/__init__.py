"""Set up an arm from a box of parts: ports, setup steps, calibration, checks, test motions.

The command line, the page and the Viam sensor all call this. It may import ``rig`` and what is
below it.
"""
