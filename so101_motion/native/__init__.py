"""The compiled part of planning and driving: C sources, and the loader of their library.

``build_native.py`` at the top of the checkout compiles them when the package is installed. Without
the library nothing plans, and no joints are driven.
"""
