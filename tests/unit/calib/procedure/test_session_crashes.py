"""A calibration killed at every write leaves the former calibration or the new one.

A write is a packet that writes to a servo, or a file opened for writing, renamed or removed. Death
is instant: nothing that the dying code tries to clean up has an effect.
"""

import pytest
from harness.calibration_rig import LentArm
from harness.dying import Death

from so101_motion.calib.procedure import journal
from so101_motion.calib.procedure.eeprom import write_held
from so101_motion.calib.procedure.session import Session
from so101_motion.calib.record import store
from so101_motion.calib.record.record import JOINTS, SERVO_IDS, JointCalibration
from so101_motion.calib.record.zero import Zero
from so101_motion.common.errors import CalibrationError
from so101_motion.drivers.emulator import registers as emulated

FORMER = {
    joint: JointCalibration(id=i, homing_offset=3 * i, range_min=900 + i, range_max=2700 + i)
    for i, joint in enumerate(JOINTS, start=1)
}
ZEROS = {"elbow_flex": Zero(by="stops", angle=0.25)}
CALIBRATED = ("shoulder_pan", "elbow_flex", "gripper")
"""Three joints are as good as six, and quicker; what the file says of the others must stay."""


class Workshop:
    """An arm with a calibration, and what becomes of both."""

    def __init__(self, folder, monkeypatch, *, has_file=True):
        folder.mkdir()
        monkeypatch.setenv("XDG_DATA_HOME", str(folder / "home"))
        self.file = folder / "arm.json"
        self.death = Death(folder)
        self.arm = LentArm(self.death)
        for joint in JOINTS:
            write_held(self.arm.bus, SERVO_IDS[joint], FORMER[joint])
        if has_file:
            store.save(self.file, FORMER, zeros=ZEROS)
        # One joint whose travel will pass the seam, so that saving changes its offset again.
        self.arm.put_deg(shoulder_pan=100, elbow_flex=30)
        self.former = self.state()
        self.death.count = 0

    def state(self):
        """What the servos would hold after a power cut, and what the file says."""
        servos = {joint: self.arm.flashed(joint) for joint in JOINTS}
        try:
            stored = store.read(self.file)
        except CalibrationError:
            assert not self.file.exists()
            return servos, None, None
        return servos, dict(stored.calibration), dict(stored.zeros)

    def calibrate(self):
        session = Session(self.file, CALIBRATED)
        session.start(self.arm)
        session.set_homing()
        session.start_recording()
        self.arm.sweep_all(CALIBRATED, step=500)
        session.stop_recording()
        session.save()

    def abort(self):
        session = Session(self.file, CALIBRATED)
        session.start(self.arm)
        session.set_homing()
        session.abort()

    def die(self, at, doing):
        """Do something, and die at its trace number ``at``; whether it came to that."""
        died = self.death.comes(at, doing)
        self.arm.watcher = None
        return died

    def recover(self):
        journal.recover(self.arm.bus, self.file)

    def check(self, *outcomes):
        """Servos and file agree on one of the outcomes, and nothing is left lying about."""
        assert self.state() in outcomes
        assert {joint: self.arm.held(joint) for joint in JOINTS} == self.state()[0]
        assert not journal.path_for(self.file).exists()
        for servo in self.arm.world.servos:
            assert servo.memory.raw(emulated.LOCK) == 1
            assert servo.drive.torque == 0


@pytest.fixture
def workshops(tmp_path, monkeypatch):
    made = []

    def make(**how):
        made.append(Workshop(tmp_path / str(len(made)), monkeypatch, **how))
        return made[-1]

    return make


def power_cut(shop):
    for servo in shop.arm.world.servos:
        servo.boot()
    shop.recover()


def new_start(shop):
    session = Session(shop.file)
    session.start(shop.arm)
    session.abort()


@pytest.mark.parametrize(
    ("put_right", "has_file", "step"),
    [
        (Workshop.recover, True, 1),
        (Workshop.recover, False, 4),
        (power_cut, True, 7),
        (new_start, True, 9),
    ],
)
def test_dying_anywhere_leaves_the_former_calibration_or_the_new_one(
    workshops, put_right, has_file, step
):
    whole = workshops(has_file=has_file)
    whole.calibrate()
    new, traces = whole.state(), whole.death.count
    assert new[1] is not None
    assert 50 < traces < 120
    became_new = []
    for at in range(0, traces, step):
        shop = workshops(has_file=has_file)
        assert shop.die(at, shop.calibrate)
        file_said = shop.state()[1]
        assert file_said in (shop.former[1], new[1])  # even before anybody has looked
        put_right(shop)
        shop.check(shop.former, new)
        became_new.append(shop.state() == new)
    # There is one instant before which nothing has happened and after which all has.
    assert became_new == sorted(became_new)
    assert {True, False} == set(became_new)


def test_dying_while_aborting_leaves_the_former_calibration(workshops):
    whole = workshops()
    whole.abort()
    assert whole.state() == whole.former
    for at in range(0, whole.death.count, 2):
        shop = workshops()
        assert shop.die(at, shop.abort)
        shop.recover()
        shop.check(shop.former)


def test_dying_again_while_that_is_put_right_changes_nothing_about_it(workshops):
    whole = workshops()
    whole.calibrate()
    new, traces = whole.state(), whole.death.count
    for at in range(3, traces, 17):
        again = 0
        while True:
            shop = workshops()
            shop.die(at, shop.calibrate)
            outcome = new if (noted := journal.read(shop.file)) and noted.is_decided else None
            if not shop.die(again, shop.recover):
                break
            shop.recover()
            shop.check(*((outcome,) if outcome else (shop.former, new)))
            again += 5
