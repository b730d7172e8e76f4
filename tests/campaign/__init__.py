"""The campaign: long attacks with seeds, to be repeated; ``make campaign MINUTES=10``.

``readers.py`` with ``mutator.py`` feeds every reader what nobody would write. ``torn_answers.py``
spoils answers on the bus, ``good_answers.py`` looks whether good ones are refused.
``interleavings.py`` mixes requests to an arm at random (``campaign_arm.py``), and faults with them,
on pretended time. ``sessions.py`` does so with the real module process in real time, and stops the
process now and then. ``kept_files.py`` kills writers of files and takes their disk away. The
referee watches all arms. A short share of each runs with the tests.
"""
