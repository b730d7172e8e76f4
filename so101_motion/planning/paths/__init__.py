"""Collision-free joint paths: the straight line, a search when that is blocked, and shortening.

``path.py`` runs them in order. It may import ``planning.collision`` and the rooms below that.
"""
