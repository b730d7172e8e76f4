"""Plan for several arms that stand in one cell.

``together.py`` plans one motion for all of them, which they begin and end at the same time;
``handover.py`` finds where two of them can meet to pass an object on. How one arm is planned for
among others is in ``planning/among.py``; whether two stay apart, in ``collision/apart.py``.
"""
