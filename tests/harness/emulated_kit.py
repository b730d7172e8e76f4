"""Servos of an arm in the tests' own process, on a port that the module's process opens.

They are those of ``so101 emulate --realtime``, and time is real unless ``now`` says otherwise. The
tests do what a person does to a kit: they plug servos in and out, place joints, and lead them to
their stops.
"""

import math
import threading
import time
from contextlib import contextmanager

from harness.held_calibration import lead, put
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.hand import Hand, parse_script
from so101_motion.drivers.emulator.joint_figures import JOINTS
from so101_motion.drivers.emulator.pty_port import Pacing

NEW = dict.fromkeys(range(1, 7), 1)
"""Ids of servos that come out of the box."""


class Kit:
    """Six servos on a port.

    Attributes:
        port: A link to the port.
        world: The servos.
    """

    def __init__(self, folder, *, now=time.monotonic, **options):
        self.port = str(folder / "arm")
        self._emulator = Emulator(
            EmulatorOptions(
                link=folder / "arm", calibrated=False, pacing=Pacing(realtime=True), **options
            ),
            now=now,
        )
        self.world = self._emulator.world

    def close(self):
        self._emulator.close()

    # Plugs

    def plug_in(self, *joints):
        """Have these servos on the cable, started up, and no others."""
        for joint in JOINTS:
            (self.world.connect if joint in joints else self.world.disconnect)(joint)
        for _ in range(1200):
            if self.are_up(joints):
                return
            threading.Event().wait(0.05)
        raise AssertionError(f"{joints} did not start up")

    def are_up(self, joints):
        self._emulator.advance()
        return all(self.world.servo(joint).drive.powered for joint in joints)

    def unplug(self):
        self._emulator.unplug()

    def plug(self):
        self._emulator.plug()

    # The hand

    def put(self, share, joints=JOINTS):
        put(self.world, share, joints)

    def lead(self, shares, joints=JOINTS):
        lead(self._emulator, shares, joints)

    def hold(self, **pose):
        """Let a hand lead all joints to ``pose`` [rad], zeros by default, and keep them there."""
        lines = [f"0 {joint} start" for joint in JOINTS]
        lines += [f"1 {joint} {math.degrees(pose.get(joint, 0.0))}" for joint in JOINTS]
        with self.world.lock:
            self.world.hand = Hand(parse_script("\n".join(lines)), self._emulator.now())

    def let_go(self):
        with self.world.lock:
            self.world.hand = Hand()

    # The truth

    @property
    def ids(self):
        return [servo.memory.raw(reg.ID) for servo in self.world.servos]

    @property
    def driven(self):
        return [servo.memory.raw(reg.TORQUE_ENABLE) == 1 for servo in self.world.servos]

    @property
    def offsets(self):
        return {
            servo.joint.name: reg.decode_offset(servo.memory.raw(reg.OFFSET))
            for servo in self.world.servos
        }


@contextmanager
def new_kit(folder, **options):
    """A kit in its box: all ids are 1, nothing is plugged in, and no two servos look alike."""
    with emulated_kit(folder, ids=NEW, **options) as kit:
        for place, joint in enumerate(reversed(JOINTS), start=1):
            kit.put(place / 7, (joint,))
        kit.plug_in()
        yield kit


@contextmanager
def emulated_kit(folder, **options):
    kit = Kit(folder, **options)
    try:
        yield kit
    finally:
        kit.close()
