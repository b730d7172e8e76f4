"""``so101 sweep``: the verbs with long computations, on all cores or on a cluster.

``sweep.py`` has the verbs, ``place.py`` and ``check.py`` two long ones, ``options.py`` the shared
options. This room may import the same as ``cli``.
"""
