"""An arm and gripper of a running Viam machine, as a rig of this program.

``rig.py`` has the whole, which fits ``rig_like.RigLike``; ``link.py`` the thread and the
connection; ``watch.py`` what the machine tells; ``runner.py`` one motion at a time; ``executor.py``
and ``gripper.py`` what is asked of the arm and of the jaw.
"""

from so101_motion.machine.link import Access
from so101_motion.machine.rig import MachineRig
from so101_motion.machine.sensor import MachineSensor

__all__ = ["Access", "MachineRig", "MachineSensor"]
