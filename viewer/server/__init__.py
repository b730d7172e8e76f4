"""The web server of the page: who may connect, which window is in control, one thread.

May import ``page`` and the package.
"""
