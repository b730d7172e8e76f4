"""An arm that finds out what one of its servos is like, keeps it, and uses it."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from harness.emulated_rig import MIDDLES_DEG, hardware_bench

from so101_motion.calib.record import servo_file, store
from so101_motion.common.errors import Interrupted
from so101_motion.common.state import ARM_JOINTS
from so101_motion.drivers.emulator.emulator import EmulatorOptions, build_world
from so101_motion.drivers.servo_types import STS3215_12V, ServoFigures
from so101_motion.planning.goals import JointGoal
from so101_motion.setup.identify import Identification

WRIST = ServoFigures(torque=0.9, friction=1.2, dead_time=1.1)
ZEROS = dict(zip(ARM_JOINTS, np.radians(MIDDLES_DEG), strict=True))


@pytest.fixture
def bench(tmp_path, planning_process, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    with hardware_bench(tmp_path, reply_timeout=2.0, figures={"wrist_flex": WRIST}) as bench:
        yield bench


@pytest.fixture
def rig(bench, tmp_path):
    """An arm with a calibration file."""
    rig = bench.open(zero_offsets=ZEROS)
    store.save(tmp_path / "arm.json", rig.servos.calibration)
    bench.shut(rig)
    rig = bench.open(zero_offsets=ZEROS, calibration_file=tmp_path / "arm.json")
    bench.advance(1.0)
    return rig


def moved(bench, identification, outline, step=0.05):
    with ThreadPoolExecutor(1) as beside:
        moving = beside.submit(identification.move_and_record, outline)
        while not moving.done():
            bench.advance(step)
        return moving.result()


def test_a_servo_is_identified_kept_and_used_from_the_next_start_on(bench, rig, tmp_path):
    identification = Identification(rig, ("wrist_flex",))
    outline = identification.outline()
    assert "wrist_flex from" in outline.sentence
    assert outline.duration < 60.0
    moved(bench, identification, outline)
    report = identification.report(hand_is_empty=True, keeps=True)

    found = servo_file.read(tmp_path / "arm.json").servos["wrist_flex"]
    assert found.torque == pytest.approx(WRIST.torque, rel=0.1)
    assert found.friction == pytest.approx(WRIST.friction, rel=0.2)
    assert found.dead_time == pytest.approx(WRIST.dead_time, rel=0.1)
    told = report.predictions["wrist_flex"]
    assert told.as_known < 0.6 * told.as_sold, "it predicts this arm better than the type does"
    assert f"kept in {report.file}" in report.text()

    files = identification.write_recordings(tmp_path / "kept", hand_is_empty=True)
    with np.load(files[0]) as data:
        assert data["position_tick"].shape == data["load_nm"].shape == data["t_s"].shape

    bench.shut(rig)
    again = bench.open(zero_offsets=ZEROS, calibration_file=tmp_path / "arm.json")
    model = again.servos.models["wrist_flex"]
    assert model.kind.torque_per_volt == pytest.approx(
        found.torque * STS3215_12V.torque_per_volt, rel=1e-3
    )
    shares = again.arm.request(JointGoal(q=np.zeros(5))).strength.shares
    assert shares == pytest.approx((1.0, 1.0, 1.0, found.torque, 1.0), abs=1e-3)


def test_an_arm_that_is_stopped_holds_and_nothing_is_kept(bench, rig, tmp_path):
    identification = Identification(rig, ("shoulder_pan",))
    outline = identification.outline()
    identification.cancel()
    with pytest.raises(Interrupted):
        moved(bench, identification, outline)
    assert servo_file.read(tmp_path / "arm.json") is None


def test_an_emulated_arm_has_the_servos_of_a_file():
    world = build_world(EmulatorOptions(figures={"wrist_flex": WRIST}))
    wrist, elbow = (world.servo(name).drive.shaft for name in ("wrist_flex", "elbow_flex"))
    for shaft in (wrist, elbow):
        shaft.step(1.0, bridge=True, load=0.0)
    assert wrist.velocity != elbow.velocity
