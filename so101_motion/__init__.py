"""Motion for the SO-101 arm: planned, timed to the limits, stoppable at any instant.

The names a program needs are here; everything else is reached by its module. Importing this
package is cheap: Pinocchio, ruckig and toppra are loaded when they are first needed.
"""

__version__ = "0.1.0"
