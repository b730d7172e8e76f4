"""The arm and gripper of a running Viam machine, with the interface of a rig.

``machine.py`` is a connected machine, ``rig.py`` its arm and gripper. ``link.py`` is the connection
and its thread, ``reports.py`` turns readings into our joint state, ``runner.py`` runs one motion at
a time.
"""

from so101_motion.viam.client.link import Access
from so101_motion.viam.client.machine import Machine
from so101_motion.viam.client.rig import MachineRig

__all__ = ["Access", "Machine", "MachineRig"]
