"""The compiled part of planning: C sources, and how the library made of them is found.

``build_native.py`` at the top of the checkout compiles it when the package is installed. Without it
everything works as well, only slower.
"""
