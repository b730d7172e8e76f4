"""The emulated joints' range of servo ticks, from stop to stop, as a calibration would have it."""

import math

from so101_motion.drivers.bus.ticks import JointMap, Ticks
from so101_motion.drivers.emulator.joint_figures import SO101

MAPS = {
    each.name: JointMap(
        servo_id=i,
        lower_ticks=Ticks(max(math.ceil(2048 + each.lower * 4096 / math.tau), 0)),
        upper_ticks=Ticks(min(math.floor(2048 + each.upper * 4096 / math.tau), 4095)),
    )
    for i, each in enumerate(SO101, start=1)
}
