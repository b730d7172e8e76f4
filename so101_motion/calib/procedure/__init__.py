"""The calibration procedure: its steps as a table, the session that runs them, the crash journal.

Whatever asks the bus raises ``BusError``, and ``PortUnavailable`` when the port is gone. Of the
rest of ``calib`` it may import ``record`` and ``access`` alone.
"""
