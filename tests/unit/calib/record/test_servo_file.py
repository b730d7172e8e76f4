import math
from dataclasses import replace

import pytest

from so101_motion.calib.record import servo_file
from so101_motion.calib.record.servo_file import HandLoad, ServoRecord
from so101_motion.common.errors import CalibrationError
from so101_motion.drivers.servo_types import ServoFigures

ELBOW = ServoFigures(torque=0.9, friction=1.25, dead_time=1.1, play=math.radians(0.8))
WRIST = ServoFigures(torque=1.05, friction=0.8)
LOAD = HandLoad(mass=0.15, com=(0.01, 0.0, 0.02))


@pytest.fixture
def path(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return tmp_path / "arm.json"


def record(servos, at="2026-03-01T10:00:00+00:00", load=None):
    return ServoRecord(at=at, volts=12.1, servos=servos, load=load)


def test_a_saved_file_reads_back_the_same(path):
    file = servo_file.save(path, record({"elbow_flex": ELBOW, "wrist_flex": WRIST}, load=LOAD))
    assert file.name == "arm.servos.json"
    found = servo_file.read(path)
    assert found.servos["elbow_flex"].friction == 1.25
    assert found.servos["elbow_flex"].play == pytest.approx(ELBOW.play, abs=1e-5)
    assert found.servos["wrist_flex"].play is None
    assert found.load == LOAD


def test_joints_that_were_not_looked_at_keep_their_figures(path):
    assert servo_file.read(path) is None
    servo_file.save(path, record({"elbow_flex": ELBOW}))
    servo_file.save(path, record({"wrist_flex": WRIST}))
    assert set(servo_file.read(path).servos) == {"elbow_flex", "wrist_flex"}


def test_restored_figures_follow_what_they_once_followed(path):
    with pytest.raises(CalibrationError, match="identify the arm again"):
        servo_file.restore(path)
    for torque in (0.8, 0.9, 1.0):
        servo_file.save(path, record({"elbow_flex": replace(ELBOW, torque=torque)}))
    servo_file.restore(path)
    assert servo_file.read(path).servos["elbow_flex"].torque == 0.9
    assert servo_file.before(path).servos["elbow_flex"].torque == 0.8
    servo_file.restore(path)
    assert servo_file.read(path).servos["elbow_flex"].torque == 1.0
    assert servo_file.before(path).servos["elbow_flex"].torque == 0.9


@pytest.mark.parametrize(
    "text",
    ["[]", "{}", '{"servos": {"elbow_flex": {"torque": 0}}}',
     '{"volts": 12, "servos": {"elbow_flex": {"torque": 1, "friction": true, "dead_time": 1}}}',
     '{"volts": 12, "servos": {}, "load": {"mass_kg": 1}}'],
)  # fmt: skip
def test_impossible_values_are_refused(path, text):
    servo_file.servos_path(path).write_text(text)
    with pytest.raises(CalibrationError):
        servo_file.read(path)
