"""Measuring an arm's servos, keeping the result, driving with it; what ``report-arm`` records."""

import json
import resource
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from click.testing import CliRunner
from harness.emulated_rig import MIDDLES_DEG, PATIENCE, TIMEOUT, arm_client

from benchmarks.emulated_arm import arm_of, load
from so101_motion.calib.record import servo_file, store
from so101_motion.calib.record.servo_file import ServoRecord
from so101_motion.cli.measuring import nameless, registers_of, text
from so101_motion.cli.verbs import main
from so101_motion.common.errors import Interrupted, MotionError, NotPossibleNow
from so101_motion.common.state import ARM_JOINTS
from so101_motion.drivers.servo_types import STS3215_12V, ServoFigures
from so101_motion.planning.goals import JointGoal
from so101_motion.setup.identify import REPORT_REST, REPORT_SPEEDS, SWEEPS, Identification
from so101_motion.setup.identify_operation import IdentifyOperation

PAN = ServoFigures(torque=0.9, friction=1.2, dead_time=1.1)
ZEROS = dict(zip(ARM_JOINTS, np.radians(MIDDLES_DEG), strict=True))

pytestmark = pytest.mark.emulated(reply_timeout=2.0, figures={"shoulder_pan": PAN})


@pytest.fixture
def rig(bench, tmp_path):
    """An arm with a calibration file."""
    rig = bench.open(zero_offsets=ZEROS)
    store.save(tmp_path / "arm.json", rig.servos.calibration)
    bench.shut(rig)
    rig = bench.open(zero_offsets=ZEROS, calibration_file=tmp_path / "arm.json")
    bench.advance(1.0)
    return rig


def moved(bench, motions, outline, until=lambda: False):
    with ThreadPoolExecutor(1) as beside:
        moving = beside.submit(motions.move_and_record, outline)
        while not moving.done():
            bench.advance(0.05)
            if until():
                motions.cancel()
        return moving.result()


@pytest.mark.emulated(reply_timeout=PATIENCE)
@pytest.mark.timeout(600)
async def test_a_servo_is_identified_by_a_request_kept_and_used_at_once(
    models, tmp_path, monkeypatch
):
    monkeypatch.setitem(SWEEPS, "shoulder_pan", (-15.0, 15.0))
    bench, file = models, tmp_path / "arm.json"
    zeros = {joint: float(deg) for joint, deg in zip(ARM_JOINTS, MIDDLES_DEG, strict=True)}
    store.save(file, bench.open(timeout=TIMEOUT).servos.calibration)
    arm = bench.new_arm(calibration_file=str(file), joint_zero_offsets_deg=zeros)
    await bench.pass_time(1.0)
    async with arm_client(arm) as client:

        async def ask(**request):
            return await client.do_command(
                {"command": "identify", "joints": ["shoulder_pan"], **request}
            )

        before = bench.q_deg
        outline = await bench.in_time(ask(outline=True), at_most=1000.0)
        assert "shoulder_pan from" in outline["will_move"]
        assert outline["duration_s"] < 60.0
        assert bench.q_deg == pytest.approx(before, abs=0.2), "nothing has moved"

        moving = await bench.start(ask(), lambda: arm.rig.arm.state.arm_moving)
        moving.cancel()
        await bench.until_it_rests(client)
        here = bench.q_deg
        await bench.pass_time(1.0)
        assert bench.q_deg == pytest.approx(here, abs=0.5), "a client that goes away stops the arm"

        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        answer = await bench.in_time(ask(), at_most=1000.0)  # time passes while it computes
        spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
        assert spent > 0.5, "it is computed in a process of its own, for an arm may be moving"
        told = answer["joints"]["shoulder_pan"]
        assert told["off_as_known_deg"] < 0.8 * told["off_as_sold_deg"], "better than its type"
        assert answer["file"] == str(servo_file.servos_path(file))
        found = servo_file.read(file).servos["shoulder_pan"]
        assert found.friction / found.torque == pytest.approx(1.2 / 0.9, rel=0.2)
        assert arm.rig.servos.models["shoulder_pan"].figures == found, "used already"


def test_what_was_identified_is_used_for_torque_and_its_limits(bench, rig, tmp_path):
    weak = ServoFigures(torque=0.8)
    strong = ServoFigures(torque=1.1)
    servos = {"wrist_flex": weak, "elbow_flex": strong}
    servo_file.save(tmp_path / "arm.json", ServoRecord(at="2026", volts=12.0, servos=servos))
    rig.reload()
    kind = rig.servos.models["wrist_flex"].kind
    assert kind.torque_per_volt == pytest.approx(0.8 * STS3215_12V.torque_per_volt)
    shares = rig.arm.request(JointGoal(q=np.zeros(5))).strength.shares
    assert shares == (1.0, 1.0, 1.0, 0.8, 1.0), "a strong servo counts as its type"


def test_a_check_keeps_nothing_and_says_how_far_the_twin_is(bench, rig, tmp_path, monkeypatch):
    monkeypatch.setitem(SWEEPS, "wrist_flex", (-8.0, 8.0))  # enough for a check of one joint
    file = tmp_path / "arm.json"
    wrong = ServoRecord(at="2026", volts=12.0, servos={"wrist_flex": ServoFigures(friction=3.0)})
    kept = servo_file.save(file, wrong).read_bytes()
    identification = Identification(rig, ("wrist_flex",))
    moved(bench, identification, identification.outline())
    report = identification.report(hand_is_empty=True, keeps=False)
    told = report.predictions["wrist_flex"]
    assert told.as_known > 1.5 * told.as_sold, "judged by the kept figures, not by those found now"
    assert report.file is None
    assert servo_file.servos_path(file).read_bytes() == kept


@pytest.mark.parametrize("silences", [1, 100])
def test_a_joint_that_did_not_answer_for_a_while_moves_again_or_gets_no_figures(
    bench, rig, silences, monkeypatch
):
    monkeypatch.setitem(SWEEPS, "shoulder_pan", (-8.0, 8.0))  # long enough to be silent in
    identification = Identification(rig, ("shoulder_pan",))
    outline = identification.outline()
    with ThreadPoolExecutor(1) as beside:
        moving, steady, begin = beside.submit(identification.move_and_record, outline), 0, None
        while not moving.done():
            steady = steady + 1 if 0.2 < abs(rig.arm.state.qd_ref[0]) < 0.3 else 0
            silences -= steady == 50
            is_silent = silences >= 0 and 50 <= steady < 58
            bench.emulator.bus.faults.request_loss = float(is_silent)
            begin = begin or (rig.arm.state.t if steady == 50 else None)
            bench.advance(0.01)
        if silences > 0:
            with pytest.raises(MotionError, match=r"shoulder_pan did not answer for .* 3 times"):
                moving.result()
        else:
            record = moving.result()["shoulder_pan"]
            assert record.t[0] > begin, "what was recorded before is forgotten"
            assert rig.arm.state.t - begin > 1.3 * outline.duration


def test_the_operation_plans_first_moves_when_told_to_and_stops(bench, rig):
    operation = IdentifyOperation(rig)
    with pytest.raises(NotPossibleNow):
        operation.ask("move")
    before = bench.q_deg
    operation.ask("plan")
    assert "shoulder_pan from" in operation.view.text
    assert bench.q_deg == pytest.approx(before, abs=0.2)
    with ThreadPoolExecutor(1) as pool:
        moving = pool.submit(operation.ask, "move", carrying=False)
        while not rig.arm.state.arm_moving:
            assert not moving.done()
            bench.advance(0.01)
        rig.arm.start_stop()
        while not moving.done():
            bench.advance(0.01)
    assert isinstance(moving.exception(), Interrupted)
    assert operation.view.state == "idle"
    operation.close()


# What report-arm records


def test_motions_are_recorded_in_the_format_that_the_benchmark_reads(bench, tmp_path, monkeypatch):
    monkeypatch.setitem(SWEEPS, "shoulder_pan", (-8.0, 8.0))
    rig = bench.open()
    bench.advance(1.0)
    motions = Identification(rig, ("shoulder_pan",), speeds=REPORT_SPEEDS, rest=REPORT_REST)
    outline = motions.outline()
    moved(bench, motions, outline)
    recorded = motions.recorded()
    with ThreadPoolExecutor(1) as beside:
        asked = beside.submit(registers_of, rig)
        while not asked.done():
            bench.advance(0.01)
    file = tmp_path / "arm.json"
    file.write_text(text({"servos": asked.result()}, recorded))
    assert json.loads(file.read_text())["motions"] == recorded
    (motion,) = load(file).values()
    low, high = outline.sweeps[0].ends
    for name, near in (("command", 0.02), ("position", 0.01)):
        pan = motion[name][:, 0]
        np.testing.assert_allclose((pan.min(), pan.max()), (low, high), atol=near)
    assert motion["t_s"][0] == 0.0
    assert motion["volts"] == pytest.approx(12.0, abs=0.5)
    assert np.diff(motion["t_cmd_s"]).min() >= 0.0
    assert arm_of(file).registers["p_gain"] == 32


def test_a_report_needs_servos_and_names_no_port_and_no_folder(tmp_path):
    result = CliRunner().invoke(main, ["report-arm", str(tmp_path / "a.json"), "--sim"])
    assert result.exit_code == 2
    assert "no servos" in result.output
    said = "/dev/ttyACM0 is open (C:\\users\\me\\58FA.json, /home/me/a); 50 deg/s"
    assert nameless(said) == "(path) is open ((path), (path)); 50 deg/s"
