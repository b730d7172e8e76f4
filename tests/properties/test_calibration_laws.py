"""Calibration finds a joint's travel wherever the seam lies and however the servo is mounted."""

import math
import tempfile
from pathlib import Path

import pytest
from harness.calibration_rig import LentArm, recording
from hypothesis import given, settings
from hypothesis import strategies as st

from so101_motion.calib.procedure.eeprom import write_held
from so101_motion.calib.procedure.travel import TravelRecorder
from so101_motion.calib.record import zero
from so101_motion.calib.record.record import JOINTS, SERVO_IDS, HeldCalibration


@st.composite
def travels(draw):
    """A joint's stops on its encoder, and where in between it is held for homing."""
    lower = draw(st.integers(0, 4095))
    travel = draw(st.integers(57, 4000))
    return lower, travel, lower + draw(st.integers(0, travel))


def readings(draw, corners):
    """What a hand that leads a joint along ``corners`` makes it report, pauses and all."""
    at = corners[0]
    yield from [at] * draw(st.integers(3, 5))
    for corner in corners[1:]:
        while at != corner:
            way = corner - at
            most = draw(st.integers(60, 400))
            at += max(min(way, most), -most)
            yield at
        yield from [at] * draw(st.integers(2, 4))


@given(st.data(), travels(), st.integers(0, 4095), st.integers(0, 200))
def test_a_wrong_reading_anywhere_changes_nothing(data, found, wrong, when):
    lower, travel, home = found
    right = list(readings(data.draw, (home, lower, lower + travel)))
    when %= len(right)
    sweep = TravelRecorder()
    for i, encoder in enumerate([*right[:when], wrong, *right[when:]]):
        sweep.feed(0.01 * i, encoder % 4096)
    if not 2 <= when <= len(right) - 2:
        return  # among the first and last three there is no telling
    assert sweep.arc.travel == travel
    assert (sweep.arc.lower - lower) % 4096 == 0


@pytest.fixture(scope="module", autouse=True)
def own_home(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(tmp_path_factory.mktemp("home")))
        yield


mounted = st.fixed_dictionaries({joint: st.integers(0, 4095) for joint in JOINTS})
offsets = st.fixed_dictionaries({joint: st.integers(-2047, 2047) for joint in JOINTS})
shares = st.fixed_dictionaries({joint: st.floats(0.0, 1.0) for joint in JOINTS})


@settings(max_examples=6)
@given(mounted, offsets, shares)
def test_every_joint_is_calibrated_wherever_its_seam_its_offset_and_its_pose_are(
    zeros, held_before, poses
):
    arm = LentArm(joints={joint: {"zero_ticks": ticks} for joint, ticks in zeros.items()})
    for joint, offset in held_before.items():
        write_held(arm.bus, SERVO_IDS[joint], HeldCalibration(homing_offset=offset))
        lower, upper = arm.stops(joint)
        arm.put(**{joint: round(lower + poses[joint] * (upper - lower))})
    at_home = {joint: arm.drive(joint).q for joint in JOINTS}
    with tempfile.TemporaryDirectory() as folder:
        session = recording(Path(folder) / "arm.json", arm)
        # At 700 ticks a sample the speed register is at its end, 7FFF. With a checksum of FF that
        # answer holds a header, and is rightly taken for one cut short; a sample is lost.
        arm.sweep_all(step=400)
        session.stop_recording()
        stored = session.save()
    for joint, entry in stored.calibration.items():
        assert entry.held == arm.held(joint) == arm.flashed(joint)
        assert 0 <= entry.range_min < entry.range_max <= 4095
        found = (entry.range_min + entry.homing_offset, entry.range_max + entry.homing_offset)
        for end, stop in zip(found, arm.stops(joint), strict=True):
            assert abs((end - stop + 2048) % 4096 - 2048) <= 3
        if joint == "gripper":
            continue
        at_zero = zero.zero_ticks(entry, stored.zeros[joint]) + entry.homing_offset
        truth = zeros[joint]
        if joint == "wrist_roll":
            truth += (at_home[joint] - zero.ROLL_UPRIGHT) * 4096 / math.tau
        assert abs((at_zero - truth + 2048) % 4096 - 2048) < 0.5 * 4096 / 360
