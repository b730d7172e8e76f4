"""Set up motors: find a servo, set its id and settings, check the finished chain.

Functions that use the bus raise ``BusError``, and ``PortUnavailable`` when the port is gone. It may
import ``calib.procedure`` and ``calib.record``.
"""
