"""The serial port: open it exclusively, list the ports, and say why one cannot be used.

The only place that imports pyserial.
"""
