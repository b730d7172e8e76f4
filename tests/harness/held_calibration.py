"""Calibrations of emulated servos, held by them or in a file; joints put at a share of a travel."""

import threading

from so101_motion.calib.record import record, store
from so101_motion.drivers.emulator import registers as emu


def hold_calibration(world, entries):
    """Store the offsets and limits of a calibration in the servos, for good; they restart."""
    for joint, entry in entries.items():
        servo = world.servo(joint)
        memory = servo.memory
        memory.keep(emu.OFFSET, emu.encode_offset(entry.homing_offset))
        memory.keep(emu.MIN_POSITION, entry.range_min)
        memory.keep(emu.MAX_POSITION, entry.range_max)
        servo.boot()


def put(world, share, joints=record.JOINTS):
    """Put joints at a share of their travel, from one stop to the other."""
    with world.lock:
        for joint in joints:
            drive = world.servo(joint).drive
            assert drive.torque != 1, f"{joint} is held; it would be back in no time"
            shaft = drive.shaft
            shaft.put(round(shaft.lower + share * (shaft.upper - shaft.lower)))


READS = 4
"""How often servos are read before a hand leads joints on; the first may have been on its way."""


def lead(emulator, shares, joints=record.JOINTS):
    """Put joints at one share of their travel after the other, as fast as somebody reads them."""
    read = threading.Semaphore(0)

    def observe(_t, _data):
        read.release()

    emulator.bus.observers.append(observe)
    for share in shares:
        put(emulator.world, share, joints)
        for _ in range(READS):
            assert read.acquire(timeout=60.0), "nobody reads"
    emulator.bus.observers.remove(observe)


def forget_limits(world):
    """Give the servos the limits of new ones: a file's limits are taken, until they restart."""
    for joint in record.JOINTS:
        memory = world.servo(joint).memory
        memory.keep(emu.MIN_POSITION, 0)
        memory.keep(emu.MAX_POSITION, 4095)


def filed(bench, *, is_new=True, offsets=None, **ends):
    """A calibration file in which the joints named have other ends or homing offsets [tick].

    The servos hold no calibration then, unless they are not new.
    """
    usual = {"wrist_roll": (200, 3900), "gripper": (1950, 3300)}
    entries = {
        joint: record.JointCalibration(
            id=i,
            range_min=lower,
            range_max=upper,
            homing_offset=(offsets or {}).get(joint, 0),
            norm_mode=1 if joint == "gripper" else 3,
        )
        for i, joint in enumerate(record.JOINTS, start=1)
        for lower, upper in [ends.get(joint, usual.get(joint, (900, 3100)))]
    }
    path = bench.port.parent / "calibration.json"
    store.save(path, entries)
    if is_new:
        forget_limits(bench.world)
    return path
