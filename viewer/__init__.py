"""The browser preview: shows the arm, its plans and its motion; decides nothing.

A plain view model (unit-tested, no viser) lies under a thin viser layer. What the page can do,
the command line can do.
"""

from .app import Preview, serve, serve_source
from .recording import film_of_plan, write_recording
from .setup.app import SetupApp, serve_setup
from .source import Source

__all__ = [
    "Preview",
    "SetupApp",
    "Source",
    "film_of_plan",
    "serve",
    "serve_setup",
    "serve_source",
    "write_recording",
]
