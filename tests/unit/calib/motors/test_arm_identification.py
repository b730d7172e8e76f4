from pathlib import Path

import pytest
from harness.lent_bus import LentBus

from so101_motion.calib.motors.arm_identification import fits, look, read_facts, role
from so101_motion.calib.record.file_search import FoundFile
from so101_motion.calib.record.record import JOINTS, SERVO_IDS, JointCalibration
from so101_motion.calib.record.store import Stored
from so101_motion.common.errors import CorruptReply, NoReply
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.servo_types import STS3215_7V4


def seen_on(bus):
    return bus.call(look)


def file_of(bus, *, role="unknown", without=(), **changes):
    """A calibration file that says what the servos of ``bus`` hold, but for ``changes``."""
    calibration = {
        joint: JointCalibration(
            id=place,
            homing_offset=bus.holds(place, reg.HOMING_OFFSET),
            range_min=bus.holds(place, reg.MIN_POSITION),
            range_max=bus.holds(place, reg.MAX_POSITION) + changes.get(joint, 0),
        )
        for place, joint in enumerate(JOINTS, start=1)
        if joint not in without
    }
    path = Path("/somewhere/arm.json")
    stored = Stored(path=path, calibration=calibration, zeros={}, notes=())
    return FoundFile(path=path, origin="LeRobot", role=role, name="arm", stored=stored, problem="")


def test_a_finished_arm_is_seen_without_being_written_to():
    bus = LentBus()
    seen = seen_on(bus)
    assert seen.has_arm
    assert seen.has(6)
    assert not seen.is_empty
    assert seen.unexpected_ids == ()
    assert seen.baud == 1_000_000
    assert sorted(seen.servos) == [1, 2, 3, 4, 5, 6]
    facts = seen.servos[6]
    assert (facts.model, facts.firmware, facts.volts) == ("sts3215", "3.10", 12.0)
    assert (facts.lowest_volts, facts.highest_volts, facts.nominal_volts) == (4.0, 14.0, 12.0)
    assert facts.is_calibrated
    assert all(packet[4] in (1, 2, 0x82) for _, packet in bus.wire.sent)


def test_an_arm_needs_five_servos_of_its_kind():
    bus = LentBus({1: 1, 2: 2, 3: 3, 5: 5, 6: 6})
    assert not seen_on(bus).has_arm
    seen = seen_on(LentBus({1: 1, 2: 2, 3: 3, 4: 4, 5: 5, 6: 9}))
    assert (seen.has_arm, seen.has(6), seen.unexpected_ids) == (True, False, (9,))
    bus = LentBus()
    bus.set(3, model_number=2825)
    seen = seen_on(bus)
    assert seen.has_arm, "a stronger servo with the same registers"
    assert seen.servos[3].model == "sts3250"
    bus.set(3, model_number=4711)
    assert not seen_on(bus).has_arm
    assert seen_on(bus).servos[3].model == "model 4711"


def test_a_servo_that_is_not_there_or_not_alone_cannot_be_read():
    bus = LentBus({1: 1, 2: 1})
    with pytest.raises(CorruptReply):
        bus.call(lambda wire: read_facts(wire, 1))
    with pytest.raises(NoReply):
        bus.call(lambda wire: read_facts(wire, 5))


# Calibration files


def test_a_file_fits_the_arm_whose_servos_hold_it_and_one_that_cannot_be_used_nobody():
    bus = LentBus()
    seen = seen_on(bus)
    assert fits(seen, file_of(bus))
    assert fits(seen, file_of(bus, wrist_flex=-1)), "one tick is the published module's rounding"
    assert not fits(seen, file_of(bus, wrist_flex=-2))
    assert not fits(seen, file_of(bus, gripper=-2))
    assert fits(seen, file_of(bus, without=("gripper",)))
    assert not fits(seen, file_of(bus, without=("elbow_flex",))), "half a file could be anybody's"
    file = file_of(bus)
    bus.set(2, homing_offset=-300)
    assert not fits(seen_on(bus), file)
    assert fits(seen_on(bus), file_of(bus))
    bus = LentBus()
    found = FoundFile(
        path=Path("/a"), origin="LeRobot", role="leader", name="a", stored=None, problem="not JSON"
    )
    assert not fits(seen_on(bus), found)
    assert role(seen_on(bus), [found])[0] == "follower"


# Leader or follower


def low_voltage():
    return LentBus(kind=STS3215_7V4, volts=7.4)


@pytest.mark.parametrize("kept_for", ["leader", "follower"])
def test_lerobots_own_file_decides(kept_for):
    for bus in (low_voltage(), LentBus()):
        found, because = role(seen_on(bus), [file_of(bus, role=kept_for)])
        assert found == kept_for
        assert "arm.json" in because


def test_what_lerobot_stores_in_a_follower_makes_a_follower():
    bus = low_voltage()
    bus.set(6, protection_current=250, overload_torque=25)
    assert role(seen_on(bus))[0] == "follower"
    bus = low_voltage()
    for place in SERVO_IDS.values():
        bus.set(place, p_gain=16)
    assert role(seen_on(bus))[0] == "follower"


def test_anything_else_is_unknown():
    bus = low_voltage()
    not_its_own = file_of(bus, role="leader", gripper=-50)
    assert role(seen_on(bus), [not_its_own])[0] == "unknown"
    assert role(seen_on(low_voltage())) == (
        "unknown", "leaders and followers both have 7.4 V servos, and nothing tells them apart",
    )  # fmt: skip
    bus = LentBus({1: 1, 2: 2})
    assert role(seen_on(bus))[0] == "unknown"
    five = LentBus({place: place for place in range(1, 6)}, kind=STS3215_7V4, volts=7.4)
    assert role(seen_on(five))[0] == "unknown"
