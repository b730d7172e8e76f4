"""The compiled part of planning: C sources, and the loader of the library built from them.

``build_native.py`` at the top of the checkout compiles them when the package is installed. Without
the library everything works, only slower.
"""
