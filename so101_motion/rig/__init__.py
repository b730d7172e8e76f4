"""Put an arm together: driver, control loop, arm and gripper, simulated or on a serial port.

``rig.py`` has what both kinds share, ``simulated_rig.py`` and ``hardware_rig.py`` open them. No
other room knows which driver is used. It may import ``arm``, ``calib`` and what is below them.
"""
