"""The browser preview: shows the arm, its plans and its motion; decides nothing.

A plain view model (unit-tested, no viser) lies under a thin viser layer. What the page can do,
the command line can do.
"""

from .app import Preview, serve

__all__ = ["Preview", "serve"]
