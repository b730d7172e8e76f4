"""The setup in the browser: from a box of parts to a moving arm, step by step.

``step_wizard.py`` knows which step is on the page and remembers it, ``page.py`` has the pages
of the steps, ``setup_context.py`` is what they share, ``setup_target.py`` is the arm that
is set up. ``part.py`` puts the pages into a tab; ``../setup_app.py`` serves that tab by itself. It
may import ``page``, ``scene``, ``server`` and the package, not the preview.
"""

from .part import SetupPart

__all__ = ["SetupPart"]
