"""The arm and gripper of a running Viam machine, with the interface of a rig."""

from so101_motion.viam.client.link import Access
from so101_motion.viam.client.machine import Machine
from so101_motion.viam.client.rig import MachineRig

__all__ = ["Access", "Machine", "MachineRig"]
