"""The setup in the browser: from a box of parts to a moving arm, step by step.

``part.py`` is its tab and knows which step is shown, ``page.py`` has the pages of the steps. It may
import ``page``, ``scene``, ``server`` and the package, not the preview.
"""

from .part import SetupPart

__all__ = ["SetupPart"]
