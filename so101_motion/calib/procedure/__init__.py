"""The calibration procedure: its steps as a table, the session that runs them, the crash journal.

Whatever asks the bus raises ``BusError``, and ``PortUnavailable`` when the port is gone. It may
import ``calib.record``.
"""
