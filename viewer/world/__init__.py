"""The World tab: obstacles, held objects and keep-out zones, edited by hand.

May import ``page``, ``scene`` and the package.
"""
