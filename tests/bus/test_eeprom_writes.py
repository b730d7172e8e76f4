"""Which commands store something in the servos: only those that were asked to."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from harness.lerobot_data import swing, write_data_set
from harness.terminal_user import Typist
from so101_viewer import serve

from so101_motion.calib.record import store
from so101_motion.cli.verbs import main as cli
from so101_motion.common.errors import OtherCalibration
from so101_motion.drivers.bus.defaults import SERVO_IDS
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.rig.hardware_rig import open_hardware, open_without_waiting
from so101_motion.rig.port_settings import ServoSettings
from so101_motion.tasks.guided import GuidedPath
from so101_motion.tasks.guided import files as guided_files
from so101_motion.tasks.program import Program, Waypoint
from so101_motion.tasks.program import files as program_files

ROWS = {
    "shoulder_pan": (1, -100, 693, 3400),
    "shoulder_lift": (2, 40, 851, 3223),
    "elbow_flex": (3, -120, 948, 3145),
    "wrist_flex": (4, 90, 890, 3210),
    "wrist_roll": (5, -700, 0, 4094),
    "gripper": (6, 150, 2030, 3260),
}


def file_of(path, shift, limit=0):
    """A file with other offsets and limits than the servos hold [tick]."""
    rows = {
        joint: {"id": i, "homing_offset": o + shift, "range_min": a + limit, "range_max": b - limit}
        for joint, (i, o, a, b) in ROWS.items()
    }
    path.write_text(json.dumps(rows))
    return str(path)


@pytest.fixture
def arm(tmp_path):
    q = tuple(map(math.radians, (0, -45, 45, 60, 0, 20)))
    emulator = Emulator(EmulatorOptions(link=tmp_path / "arm", q_start=q), gravity=np.zeros_like)
    with emulator.world.lock:
        for servo, (_, offset, lower, upper) in zip(
            emulator.world.servos, ROWS.values(), strict=True
        ):
            servo.memory.keep(reg.OFFSET, offset if offset >= 0 else -offset | 2048)
            servo.memory.keep(reg.MIN_POSITION, lower)
            servo.memory.keep(reg.MAX_POSITION, upper)
            servo.memory.keep(reg.STATUS_LEVEL, 0)  # to be repaired whenever it is driven
    yield emulator
    emulator.close()


def stored(emulator):
    with emulator.world.lock:
        return [servo.memory.flash for servo in emulator.world.servos]


GOAL = ("--joints", "0,-40,45,60,0")
REFUSED = 4


@pytest.fixture
def files(tmp_path):
    """What verbs need beside an arm: a program, a guided path and a data set."""
    q = np.radians([[0, -45, 45, 60, 0], [0, -44, 45, 60, 0]])
    waypoints = tuple(Waypoint(name=name, q=each) for name, each in zip("ab", q, strict=True))
    program_files.write(Program.of_waypoints(waypoints), tmp_path / "program.json")
    guided_files.write(GuidedPath(t=[0.0, 1.0], q=q, aperture=[0.2, 0.2]), tmp_path / "path.json")
    write_data_set(tmp_path / "set", [swing(n=30)])


LOOKS = (
    ("status",),
    ("ports",),
    ("doctor",),
    ("viam", "config"),
    ("plan", *GOAL),
    ("calibration", "diff", "other.json"),
    ("identify", "--undo"),
)
MOVES = (
    ("move", *GOAL),
    ("run", "program.json"),
    ("guide", "record", "new.json", "--seconds", "0.3"),
    ("guide", "replay", "path.json"),
    ("dataset", "replay", "set", "--episode", "0", "--units", "degrees"),
    ("move-test",),
    ("identify",),
    ("teleop", "--follower", "sim", "--seconds", "0.3"),
)


def place(verb, tmp_path, file):
    """The options of ``verb`` for the arm and its calibration."""
    port = str(tmp_path / "arm")
    if verb[0] == "teleop":
        return ("--leader", port, "--leader-calibration", file)
    takes_file = verb in MOVES or verb[0] in ("status", "plan", "doctor", "identify")
    return ("--port", port, *(("--calibration", file) if takes_file else ()))


def test_what_looks_at_an_arm_stores_nothing(arm, files, tmp_path, monkeypatch):
    for verb in LOOKS:
        monkeypatch.chdir(tmp_path)
        file, before = file_of(tmp_path / "other.json", 30), stored(arm)
        result = CliRunner().invoke(cli, [*verb, *place(verb, tmp_path, file)])
        assert result.exception is None or isinstance(result.exception, SystemExit), result.output
        assert stored(arm) == before


def test_what_moves_an_arm_refuses_another_calibration(arm, files, tmp_path, monkeypatch):
    for verb in MOVES:
        monkeypatch.chdir(tmp_path)
        file, before = file_of(tmp_path / "other.json", 30), stored(arm)
        result = CliRunner().invoke(cli, [*verb, *place(verb, tmp_path, file), "--yes"])
        assert result.exit_code == REFUSED, result.output
        assert "so101 calibration write" in result.output
        assert stored(arm) == before


@pytest.mark.parametrize(
    ("offset", "limit"),
    [
        (1, 0),  # the published module is a tick off
        (0, 30),  # the travels were recorded anew
    ],
)
def test_an_arm_that_is_moved_with_its_calibration_stores_nothing(arm, tmp_path, offset, limit):
    file, before = file_of(tmp_path / "own.json", offset, limit), stored(arm)
    verb = ("move", *GOAL)
    result = CliRunner().invoke(cli, [*verb, *place(verb, tmp_path, file), "--yes"])
    assert result.exit_code == 0, result.output
    assert stored(arm) == before
    with arm.world.lock:
        assert arm.world.servo("elbow_flex").memory.raw(reg.MIN_POSITION) == 948 + limit


def test_python_and_the_page_store_nothing(arm, tmp_path):
    file, before = Path(file_of(tmp_path / "own.json", 0, 30)), stored(arm)
    settings = ServoSettings(port=str(tmp_path / "arm"), calibration_file=file)
    looks = replace(settings, timeout=None)
    with open_hardware(looks) as rig, serve(rig, port=0):  # as "so101 view" does
        assert stored(arm) == before
    with open_hardware(settings.with_arm(SERVO_IDS)) as rig:
        assert rig.servos.calibration["elbow_flex"].range_min == 978
    other = replace(settings, calibration_file=Path(file_of(tmp_path / "other.json", 30)))
    with pytest.raises(OtherCalibration, match=r"probably the arm of that file|another arm"):
        open_hardware(other.with_arm(SERVO_IDS))
    assert stored(arm) == before


def test_a_module_refuses_another_calibration_and_says_how_to_accept_it(arm, tmp_path):
    file, before = Path(file_of(tmp_path / "other.json", 30)), stored(arm)
    settings = ServoSettings(port=str(tmp_path / "arm"), calibration_file=file)
    with open_without_waiting(settings.with_arm(SERVO_IDS)) as rig:
        rig.first_try.result(10.0)
        assert "so101 calibration write" in rig.not_ready
        assert '"command": "write_calibration"' in rig.not_ready
        assert stored(arm) == before
        kept = rig.write_calibration()
        assert rig.not_ready is None
        assert store.read(kept).calibration["elbow_flex"].homing_offset == -120
    assert stored(arm) != before


MOVE = ("move", "cell.json", "--joints", "a", GOAL[1], "--yes")
RUN = ("run", "cell.json", "wave.json", "--yes")
HANDOVER = ("handover", "cell.json", "a", "b", "stick")


@pytest.mark.parametrize(
    ("verb", "shift"),
    [(MOVE, 0), (MOVE, 30), (RUN, 30), (HANDOVER, 30)],
    ids=["move", "move refused", "run refused", "handover refused"],
)
def test_a_cell_stores_nothing(arm, tmp_path, monkeypatch, verb, shift):
    folder = tmp_path / "robots" / "so_follower"
    folder.mkdir(parents=True)
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    file_of(folder / "mine.json", shift)
    before = stored(arm)
    entry = {"name": "a", "port": str(tmp_path / "arm"), "calibration_id": "mine"}
    stick = {"name": "stick", "box_mm": [20, 20, 160], "position_mm": [0, 0, 150], "mass_kg": 0.04}
    if verb[-1] == "stick":
        entry["attached"] = [stick]
    other = {"name": "b", "position_mm": [700, 0, 0], "rpy_deg": [0, 0, 180]}
    Path("cell.json").write_text(json.dumps({"arms": [{**entry, "position_mm": [0, 0, 0]}, other]}))
    steps = [{"a": {"q_deg": [0, -40, 45, 60, 0]}, "b": {"q_deg": [0, -50, 50, 60, 0]}}]
    Path("wave.json").write_text(json.dumps({"schema": "so101/cell-program/1", "steps": steps}))
    result = CliRunner().invoke(cli, ["cell", *verb])
    assert ("so101 calibration write" in result.output) == bool(shift), result.output
    assert result.exit_code == (REFUSED if shift else 0), result.output
    assert stored(arm) == before


def test_a_verification_stores_nothing(arm, tmp_path):
    file, before = file_of(tmp_path / "own.json", 0), stored(arm)
    with Typist("calibration", "verify", file, "--port", str(tmp_path / "arm")) as person:
        for words in ("about to go limp", "joints are limp"):
            person.sees(words)
            person.presses("\n")
        assert person.code() != 0
    assert stored(arm) == before


def test_a_written_calibration_can_be_put_back(arm, tmp_path):
    file, before, port = file_of(tmp_path / "other.json", 30), stored(arm), str(tmp_path / "arm")
    result = CliRunner().invoke(cli, ["calibration", "write", file, "--port", port, "--yes"])
    assert result.exit_code == 0, result.output
    assert stored(arm) != before
    kept = result.output.split("so101 calibration write ")[1].split(" --port")[0]
    CliRunner().invoke(cli, ["calibration", "write", kept, "--port", port, "--yes"])
    assert stored(arm) == before


def test_restoring_a_calibration_stores_it_in_servos_that_are_named(arm, tmp_path, files):
    own, before = file_of(tmp_path / "own.json", 0), stored(arm)
    runs = CliRunner()
    place = ("--port", str(tmp_path / "arm"))
    other = file_of(tmp_path / "other.json", 30)
    assert not runs.invoke(cli, ["calibration", "import", other, "--file", own]).exit_code
    assert not runs.invoke(cli, ["calibration", "write", own, *place, "--yes"]).exit_code
    assert stored(arm) != before
    result = runs.invoke(cli, ["calibration", "restore", own, *place])
    assert result.exit_code == 2
    assert "give --yes" in result.output
    result = runs.invoke(cli, ["calibration", "restore", own, *place, "--yes"])
    assert result.exit_code == 0, result.output
    assert stored(arm) == before
