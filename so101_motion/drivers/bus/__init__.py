"""The servo bus: packets, registers, ticks, transactions, retries and counters.

``bus.py`` has the transactions, ``protocol.py`` the bytes of a control cycle without a port,
``registers.py`` the servo's table. It may import ``drivers.port``.
"""
