"""The campaign: long attacks with seeds, to be repeated; ``make campaign MINUTES=10``.

``readers.py`` with ``mutator.py`` feeds every reader what nobody would write. ``interleavings.py``
mixes requests to an arm at random, and faults on its bus with them, on pretended time and under the
referee's eyes. A short share of each runs with the tests.
"""
