"""``so101 sweep``: the verbs that compute for long, on all cores or on a cluster.

``sweep`` has the verbs, ``place`` and ``check`` the two long ones, ``options`` what they share.
It may import what ``cli`` may.
"""
