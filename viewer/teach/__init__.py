"""The Teach tab: paths that a hand shows, and a leader arm that this one follows.

May import ``page``, ``scene``, ``view_model`` and the package.
"""
