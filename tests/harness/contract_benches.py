"""Arms of several kinds that the contract of an arm is tried on.

Each bench has a ``rig`` and the same few verbs: begin to move, let time pass, wait for an end.
"""

import threading

import numpy as np

from harness.emulated_rig import ArmBench, HardwareBench
from harness.viam_machine import until_true
from so101_motion.common.clock import ManualClock
from so101_motion.drivers.simulated import SimArm
from so101_motion.planning.collision.scene import Scene
from so101_motion.rig.rig import Rig
from so101_motion.viam.client import MachineRig


class Simulated(HardwareBench):
    """A simulated arm on a clock that the test moves."""

    def __init__(self):
        self.clock = ManualClock()
        self._arm = SimArm(self.clock)
        caps = {"speed": np.radians(90.0), "acceleration": np.radians(100.0)}
        self.rig = Rig(self._arm, clock=self.clock, scene=Scene(), **caps)
        self._rigs = [self.rig]

    def arm_deg(self, rig):
        return np.degrees(rig.arm.state.q)

    def put_between_the_jaws(self):
        self.finish(self.rig.gripper.move(0.4, wait=False))
        self._arm.jam("gripper")

    def take_away(self):
        self._arm.unjam("gripper")

    def close(self):
        self.rig.close()


class Emulated(HardwareBench):
    """The real driver on emulated servos."""

    def __init__(self, folder):
        super().__init__(folder, reply_timeout=2.0)
        self.rig = self.open()
        self.advance(1.0)  # the weight is taken up

    def put_between_the_jaws(self):
        self.world.put_object(0.03)

    def take_away(self):
        self.world.take_object()


class Real(ArmBench):
    """A real arm (``--hardware PORT``)."""

    def __init__(self, port):
        super().__init__(port)
        self.rig = self.open()


class OnMachine(ArmBench):
    """The simulated arm of a real module process, over TCP; time is real."""

    def __init__(self, machine):
        self.rig = MachineRig.connect(machine.address)
        self.rig.arm.set_speed(np.radians(90.0))
        self.rig.arm.set_acceleration(np.radians(400.0))
        self._rigs = [self.rig]

    def advance(self, seconds):
        threading.Event().wait(min(seconds, 0.2))

    def under_way(self, motion, rig, seconds=0.3):
        begin = rig.arm.state.q
        until_true(lambda: motion.future.done() or np.ptp(rig.arm.state.q - begin) > 0.005)
