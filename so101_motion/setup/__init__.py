"""From a box of parts to an arm that works: ports, setup steps, calibration, checks, test motions.

The command line, the page and the Viam sensor all call this. It may import ``rig`` and what is
below it.
"""
