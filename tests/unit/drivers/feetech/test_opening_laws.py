"""Opening and holding an arm moves nothing, whatever state its servos are in."""

import math

import numpy as np
from harness.servo_stand import WEIGHT, Stand
from hypothesis import given, settings
from hypothesis import strategies as st

from so101_motion.common.clock import ManualClock
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.ticks import JointMap, Ticks
from so101_motion.drivers.emulator.joint_figures import SO101
from so101_motion.drivers.feetech.feetech_arm import JOINTS

angles = st.tuples(
    *(
        st.floats(joint.lower + math.radians(3.0), joint.upper - math.radians(3.0))
        for joint in SO101
    )
)


def put(servo, row, value):
    servo.write(bytes((row.address, *row.encode(value))))


class Found(Stand):
    """An arm as somebody left it, and the driver that finds it."""

    def __init__(self, wired, q_start, driven, heavier):
        clock = ManualClock()
        port = wired(
            now=clock.now, gravity=lambda q: heavier * WEIGHT(q), q_start=q_start, calibrated=False
        )
        super().__init__(clock, port)
        for servo, holds in zip(port.world.servos, driven, strict=True):
            put(servo, reg.LOCK, 0)
            if holds:
                put(servo, reg.GOAL_POSITION, servo.drive.position)
                put(servo, reg.TORQUE_ENABLE, 1)
            else:
                servo.drive.shaft.lower = servo.drive.shaft.upper = servo.drive.shaft.output
        clock.advance(1.0)  # it sags into its goal; what is limp lies on something
        port.world.advance(clock.now())

    @property
    def left(self):
        """Joints that get no goal."""
        return {JOINTS.index(joint) for joint in self.arm.read().out_of_range}

    def open(self, maps):
        maps = dict(zip(JOINTS, maps, strict=True))
        self.connect(maps, gravity=WEIGHT, speed=math.radians(220.0), acceleration=17.0)
        self.hold()

    def look(self, seconds):
        """How far each joint moves while it is only looked at [deg]."""
        q_start, moved = self.q, np.zeros(6)
        for _ in range(round(seconds / 0.05)):
            self.arm.read()
            self.clock.advance(0.05)
            moved = np.maximum(moved, np.abs(self.q - q_start))
        return np.degrees(moved)


@st.composite
def maps(draw, offsets):
    """Limits that may or may not hold the joints."""
    found = []
    for servo_id in range(1, 7):
        lower = draw(st.integers(300, 2600))
        upper = draw(st.integers(lower + 100, 3900))
        offset = draw(st.sampled_from(offsets))
        limits = {"lower_ticks": Ticks(lower), "upper_ticks": Ticks(upper)}
        found.append(JointMap(servo_id=servo_id, homing_offset=offset, **limits))
    return found


found = {
    "q_start": angles,
    "driven": st.lists(st.booleans(), min_size=6, max_size=6),
    "heavier": st.sampled_from([1.0, 1.2]),
}


@settings(max_examples=25)
@given(**found, maps=maps([None, 0]))
def test_no_joint_moves_by_being_found_set_up_and_held(wired, q_start, driven, heavier, maps):
    arm = Found(wired, q_start, driven, heavier)
    arm.open(maps)
    assert arm.look(1.5).max() <= 0.5


@settings(max_examples=12)
@given(**found, maps=maps([150, -90]))
def test_a_new_homing_offset_takes_no_joint_along(wired, q_start, driven, heavier, maps):
    arm = Found(wired, q_start, driven, heavier)
    q_found = arm.q
    arm.open(maps)
    assert arm.look(1.5).max() <= 4.0, "while it builds up its pull anew"
    inside = [i for i in range(6) if i not in arm.left]
    assert np.degrees(np.abs(arm.q - q_found))[inside].max(initial=0.0) <= 0.6
