"""The calibration procedure: its steps as a table, the session that runs them, the crash journal.

Functions that use the bus raise ``BusError``, and ``PortUnavailable`` when the port is gone. Of the
rest of ``calib`` it may import only ``record`` and ``access``.
"""
