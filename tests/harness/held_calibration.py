"""Let emulated servos hold a calibration, as if it had been recorded on them."""

from so101_motion.calib.record import record
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


def forget_limits(world):
    """Give the servos the limits of new ones: a file's limits are taken, until they restart."""
    for joint in record.JOINTS:
        memory = world.servo(joint).memory
        memory.keep(emu.MIN_POSITION, 0)
        memory.keep(emu.MAX_POSITION, 4095)
