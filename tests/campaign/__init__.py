"""The campaign: long random attacks, repeatable by their seeds; ``make campaign EXAMPLES=50``.

``torn_answers.py`` damages answers on the bus. ``interleavings.py`` sends requests to an arm in
random order (``campaign_arm.py``), with faults among them, on simulated time. ``sessions.py`` does
so with the real module process in real time, and stops the process now and then. The referee
watches all arms. A short share of each runs with the tests.
"""
