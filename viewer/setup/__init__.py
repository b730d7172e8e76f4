"""The setup app: from a box of parts to a moving arm, step by step, in the browser.

``course.py`` knows which step it is and remembers it, ``page.py`` says what a step's page is,
``workshop.py`` is what all of them share, ``bench.py`` is the arm or the machine that is worked on.
The pages: ``connection.py``, ``motors.py``, ``chain.py``, then those of the calibration.
``part.py`` puts them on the page, ``picture.py`` draws the arm beside them, ``app.py`` serves them
without a preview.
"""

from .part import SetupPart

__all__ = ["SetupPart"]
