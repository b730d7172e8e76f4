"""An emulated arm to calibrate in one thread without waiting, and a hand that leads its joints.

Nothing waits and nothing runs by itself: a test places a joint and lets one tick pass. The
bytes and the servos are the emulator's. Everything that leaves a trace, a packet that writes or a
file operation, is counted, and the process can be made to "die" at any of them: from that instant
on neither packets nor files get anywhere, whatever the dying code still tries.
"""

import math
from contextlib import suppress
from dataclasses import replace

from harness.dying import Died
from harness.lent_bus import LentBus, WirePort
from so101_motion.calib.procedure.eeprom import read_held
from so101_motion.calib.procedure.session import Session
from so101_motion.calib.record import zero
from so101_motion.calib.record.record import JOINTS, SERVO_IDS
from so101_motion.common.errors import PortUnavailable
from so101_motion.drivers.emulator.codec import Code
from so101_motion.drivers.emulator.joint_figures import SO101

TICK = 0.01
TICKS_PER_DEG = 4096 / 360
UPRIGHT_DEG = math.degrees(zero.ROLL_UPRIGHT)


class LentPort(WirePort):
    """Counts packets that write, and dies at one of them."""

    death = None

    def write(self, data):
        if self.death is not None:
            if self.death.is_dead:
                raise Died
            if data[4] in (Code.WRITE, Code.SYNC_WRITE):
                self.death.trace()
        super().write(data)


class LentArm(LentBus):
    """An emulated arm and its ``BusAccess``.

    Args:
        death: When the process dies.
        joints: Changes to how the servos are mounted, by joint.

    Attributes:
        calls: How often the bus was asked for.
        between: Called before each, with their number: what happens meanwhile.
    """

    kind_of_port = LentPort

    def __init__(self, death=None, joints=None, **options):
        mounted = tuple(replace(joint, **(joints or {}).get(joint.name, {})) for joint in SO101)
        super().__init__(joints=mounted, q_start=(0.0,) * 6, **options)
        self.wire.death = death
        self.watcher = None
        self.calls = 0
        self.between = lambda calls: None

    def call(self, job):
        self.calls += 1
        self.between(self.calls)
        return super().call(job)

    def watch(self, job):
        self.watcher = job

    # The hand

    def tick(self, count=1):
        """Let time pass; the joints are where they were put."""
        for _ in range(count):
            self.clock.advance(TICK)
            if self.watcher is not None:
                with suppress(PortUnavailable):  # as the contract of ``watch`` has it
                    self.watcher(self.bus)

    def drive(self, joint):
        return self.world.servo(joint).drive

    def stops(self, joint):
        """The stops of a joint on its encoder [tick], unrolled."""
        shaft = self.drive(joint).shaft
        return math.ceil(shaft.lower), math.floor(shaft.upper)

    def put(self, **encoders):
        """Put joints where their encoders count so much."""
        for joint, encoder in encoders.items():
            self.drive(joint).shaft.put(float(encoder))

    def put_deg(self, **angles):
        """Put joints at these angles [deg]."""
        for joint, angle in angles.items():
            drive = self.drive(joint)
            drive.shaft.put(drive.to_ticks(math.radians(angle)))

    def sweep(self, joint, *ends, step=40):
        """Lead a joint in a straight line to each of ``ends`` on its encoder, and rest there."""
        shaft = self.drive(joint).shaft
        for end in ends:
            while shaft.output != end:
                way = end - shaft.output
                shaft.put(shaft.output + max(min(way, step), -step))
                self.tick()
            self.tick(2)

    def sweep_all(self, joints=None, **how):
        """Each joint to both its stops."""
        for servo in self.world.servos:
            name = servo.joint.name
            if joints is None or name in joints:
                self.sweep(name, *self.stops(name), **how)

    def held(self, joint):
        """Offset and limits that a servo holds now."""
        return read_held(self.bus, SERVO_IDS[joint])

    def flashed(self, joint):
        """Offset and limits that it would hold after its power was cut."""
        servo = self.world.servo(joint)
        now = bytes(servo.memory.bytes)
        servo.memory.boot()
        try:
            return self.held(joint)
        finally:
            servo.memory.bytes[:] = now


def recording(file, arm, joints=JOINTS):
    """A calibration whose recording has begun, with the joints where they are."""
    session = Session(file, joints)
    session.start(arm)
    session.set_homing()
    session.start_recording()
    return session


def calibrate(file, arm, joints=JOINTS, led=None):
    """Calibrate these joints, leading them, or those of ``led``, to their stops."""
    session = recording(file, arm, joints)
    arm.sweep_all(led or joints)
    session.stop_recording()
    return session.save()


def all_held(arm):
    return {joint: arm.held(joint) for joint in JOINTS}
