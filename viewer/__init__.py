"""The browser page: shows the arm, its plans and its motion.

Viewer models without viser decide and are tested alone; a thin viser layer shows them. What the
page can do, the command line can do. May import everything but so101_motion.cli.
"""

from .app import Preview, serve
from .panels.film import film_of_plan, write_recording
from .setup_app import SetupApp, serve_setup
from .source import Source

__all__ = [
    "Preview",
    "SetupApp",
    "Source",
    "film_of_plan",
    "serve",
    "serve_setup",
    "write_recording",
]
