"""Set up motors: find a servo, set its id and settings, check the finished chain.

Whatever asks the bus raises ``BusError``, and ``PortUnavailable`` when the port is gone. It may
import ``calib.procedure`` and ``calib.record``.
"""
