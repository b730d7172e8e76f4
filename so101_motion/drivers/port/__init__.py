"""The serial port: open it for us alone, list the ports there are, say who blocks one.

The only place that imports pyserial.
"""
