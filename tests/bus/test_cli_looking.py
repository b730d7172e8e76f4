"""The verbs that look and write nothing, on an emulated arm."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from so101_motion.calib.record import servo_file, store
from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.calib.record.zero import Zero
from so101_motion.cli.verbs import main
from so101_motion.drivers.bus import registers
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.faults import FaultEvent
from so101_motion.drivers.port.serial_port import SerialPort
from so101_motion.drivers.servo_types import ServoFigures
from so101_motion.files.cell_file import read_cell
from so101_motion.viam.component_config import HardwareArmConfig, HardwareGripperConfig


@pytest.fixture(autouse=True)
def own_folders(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for name in ("VIAM_MODULE_DATA", "VIAM_HOME"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")


@pytest.fixture
def arm(tmp_path):
    options = EmulatorOptions(link=tmp_path / "arm")
    with Emulator(options) as emulator:
        yield emulator


@pytest.fixture
def file(arm, tmp_path):
    """A calibration that says what the servos hold, saved where the user wanted it."""
    calibration = {}
    for place, (joint, servo) in enumerate(zip(JOINTS, arm.world.servos, strict=True), start=1):
        calibration[joint] = JointCalibration(
            id=place,
            range_min=servo.memory.raw(reg.MIN_POSITION),
            range_max=servo.memory.raw(reg.MAX_POSITION),
        )
    path = tmp_path / "home" / "arms" / "mine.json"
    store.save(path, calibration, zeros={"elbow_flex": Zero(by="stops", angle=-0.101)})
    return path


def run(*arguments):
    return CliRunner().invoke(main, list(arguments))


def told(*arguments):
    """What a verb tells a program."""
    return json.loads(run(*arguments, "--json").stdout)


def memories(arm):
    return [bytes(servo.memory.bytes[:56]) for servo in arm.world.servos]


def on_port(told, arm):
    return next(port for port in told["ports"] if port["port"] == arm.port)


# Ports


def test_a_port_is_listed_with_what_is_on_it(arm):
    result = run("ports", "--port", arm.port)
    assert result.exit_code == 0
    assert "a follower arm with 5 joints and a gripper" in result.stdout
    found = on_port(told("ports", "--port", arm.port), arm)
    assert found["has_arm"], found["found"]
    assert found["servo_ids"] == [1, 2, 3, 4, 5, 6]


def test_all_arms_are_in_one_table_and_nobody_has_moved(arm, file):
    before = memories(arm)
    (found,) = told("arms", "--port", arm.port)["arms"]
    assert found["calibration_file"] == str(file)
    assert memories(arm) == before


def test_an_arm_that_cannot_be_nudged_is_left_out_of_the_cell_and_named(arm, tmp_path):
    with Emulator(EmulatorOptions(link=tmp_path / "first")) as other:
        other.begin(FaultEvent(kind="dead", servo="gripper"))
        ports = ("--port", other.port, "--port", arm.port)
        asked = ("arms", *ports, "--nudge", "--cell", "class.json")
        result = CliRunner().invoke(main, asked, input="y\ny\nanna\n")
    assert result.exit_code == 6, result.output
    assert f"{other.port} is left out" in " ".join(result.stderr.split())
    assert "1 of 2 arms written" in result.stderr
    assert [each.name for each in read_cell(Path("class.json")).arms] == ["anna"]


def test_a_cell_file_that_is_there_keeps_what_it_says_and_gets_the_new_arms(arm, tmp_path):
    anna = {"name": "arm 1", "port": "/dev/gone", "max_speed_degs_per_sec": 20}
    said = {"arms": [anna], "scene": {"floor_z_mm": -5}}
    path = tmp_path / "class.json"
    path.write_text(json.dumps(said))
    asked = ("arms", "--port", arm.port, "--cell", str(path), "--max-speed", "30")
    assert "1 of 1 arm written" in run(*asked).stderr
    first, second = json.loads(path.read_text())["arms"]
    assert first == anna
    assert (second["name"], second["max_speed_degs_per_sec"]) == ("arm 2", 30)
    before = path.read_bytes()
    assert "no new arm written" in run(*asked).stderr
    assert path.read_bytes() == before
    assert read_cell(path).scene.floor_z == pytest.approx(-0.005)


@pytest.mark.parametrize("verb", [("arms",), ("viam", "config")], ids=" ".join)
def test_a_port_without_an_arm_is_named_with_what_to_do(tmp_path, verb):
    options = EmulatorOptions(link=tmp_path / "empty", ids={}, loose=True)
    with Emulator(options) as emulator:
        result = run(*verb, "--port", emulator.port)
    assert result.exit_code == 3
    assert "power supply" in " ".join(result.output.split())
    assert result.stdout == "" or verb == ("arms",), "nobody gets a configuration"


def test_the_status_of_a_limp_arm_is_reported_with_its_hot_servo(arm):
    arm.begin(FaultEvent(kind="hot", servo="gripper", value=72.0))
    arm.world.servo("elbow_flex").memory.keep(reg.MAX_POSITION, 1500)
    status = told("status", "--port", arm.port)
    assert "(72 °C, it switches off at 70)" in status["alarms"]["gripper"]
    assert status["joints_found"] == list(JOINTS)
    assert status["q_deg"]["shoulder_pan"] == pytest.approx(0.0, abs=10.0)
    result = run("status", "--port", arm.port)
    assert "gripper: its servo is too hot" in result.stderr
    assert "limp" in result.stdout
    assert status["outside_limits"] == ["elbow_flex"]
    assert "outside its limits" in result.stdout


@pytest.mark.parametrize(
    ("silent", "shown", "says"),
    [
        (JOINTS, "", "try: check that the arm's power supply is on"),
        (("elbow_flex",), "elbow_flex    does not answer", "try: support the arm, and check"),
    ],
)
def test_the_status_of_an_arm_with_silent_servos_says_what_to_check(arm, silent, shown, says):
    for joint in silent:
        arm.begin(FaultEvent(kind="dead", servo=joint))
    result = run("status", "--port", arm.port)
    assert result.exit_code == 4
    assert "now: nothing moved" in run("home", "--port", arm.port, "--yes").stderr
    assert shown in result.stdout
    assert ("limp" in result.stdout) == bool(shown)
    assert says in " ".join(result.stderr.split())


# A configuration


def test_a_configuration_is_printed_that_the_models_accept(arm, file):
    result = run("viam", "config", "--port", arm.port)
    assert result.exit_code == 0, result.output
    configuration = json.loads(result.stdout)
    arm_, gripper, calibration = configuration["components"]
    assert HardwareArmConfig.from_attributes(arm_["attributes"]).connection.port == arm.port
    assert HardwareGripperConfig.from_attributes(gripper["attributes"]).servo_id == 6
    assert calibration["model"] == "devrel:so101:calibration"
    for component in configuration["components"]:
        assert component["attributes"]["calibration_file"] == str(file)
    assert arm_["frame"] == {"parent": "world"}
    assert gripper["frame"] == {"parent": arm_["name"]}
    (module,) = configuration["modules"]
    assert module["executable_path"].endswith("run.sh")


# The doctor


@pytest.fixture(scope="module", autouse=True)
def awake(planning_process):
    """The planning process, once for all."""


def test_a_sound_arm_is_fit_to_be_moved(arm, file, tmp_path):
    before = memories(arm)
    page = tmp_path / "doctor.md"
    result = run("doctor", "--port", arm.port, "--report", str(page))
    assert result.exit_code == 0, result.output
    assert "ready to move" in result.stderr
    assert memories(arm) == before
    for words in ("so101-motion", "all six answer", str(file), "by its stops", "deg/s"):
        assert words in result.stdout
        assert words in page.read_text()
    assert "numpy" in page.read_text()
    assert json.loads(page.read_text().split("```json")[1].split("```")[0])["healthy"]


@pytest.mark.breaks("seed", reason="somebody else's arm: torque is switched on without a goal")
def test_a_held_arm_stays_held_and_is_said_to_be_although_nobody_drives_it(arm):
    bus = Bus(SerialPort(arm.port), reply_timeout=1.0)
    for servo_id in range(1, 7):
        bus.write(servo_id, registers.TORQUE_ENABLE, 1)
    bus.close()

    checks = told("doctor", "--port", arm.port)["checks"]
    assert any("the joints are held" in check["sentence"] for check in checks)
    assert told("status", "--port", arm.port)["mode"] == "holding"
    assert [servo.memory.raw(reg.TORQUE_ENABLE) for servo in arm.world.servos] == [1] * 6


def test_an_arm_with_a_loose_cable_is_not_fit_and_all_else_is_reported_too(arm, file):
    arm.world.disconnect("gripper")

    result = run("doctor", "--port", arm.port, "--calibration", str(file), "--json")
    assert result.exit_code == 6
    told = json.loads(result.stdout)
    failed = [check for check in told["checks"] if check["verdict"] == "fail"]
    assert [check["name"] for check in failed] == ["servo 6"]
    assert "cable" in failed[0]["fix"]
    assert told["bus"]["asked"] == 1000
    assert told["servos"]["elbow_flex"]["present_voltage"] == 120
    assert not told["healthy"]


def test_a_port_in_use_is_named_and_the_installation_is_checked_even_so(arm):
    port = SerialPort(arm.port)
    try:
        result = run("doctor", "--port", arm.port)
    finally:
        port.close()
    assert result.exit_code == 6
    assert "in use by" in result.stdout
    assert "a motion takes" in result.stdout


# Files against servos


def test_a_file_is_compared_with_what_the_servos_hold(arm, file):
    asked = ("calibration", "diff", str(file), "--port", arm.port)
    result = run(*asked)
    assert result.exit_code == 0, result.output
    assert "the same as in the servos" in result.stdout
    arm.world.servo("elbow_flex").memory.keep(reg.MAX_POSITION, 3000)
    arm.world.disconnect("gripper")
    result = run(*asked)
    assert result.exit_code == 6
    assert "elbow_flex: range_max is" in result.stdout
    assert "gripper: missing in the servos" in result.stdout


# Looking at an arm, and at what would be done to it


def test_what_was_identified_is_undone_without_a_motion(arm, file):
    command = ("identify", "--port", arm.port, "--calibration", str(file), "--undo")
    assert "identify the arm again" in run(*command).stderr
    for torque in (0.9, 1.1):
        figures = {"elbow_flex": ServoFigures(torque=torque)}
        found = servo_file.ServoRecord(at="2026-03-01T10:00:00", volts=12.0, servos=figures)
        servo_file.save(file, found)
    result = run(*command)
    assert result.exit_code == 0, result.output
    assert "has the figures of 2026-03-01" in result.output
    assert servo_file.read(file).servos["elbow_flex"].torque == 0.9
    assert not any(servo.memory.raw(reg.TORQUE_ENABLE) for servo in arm.world.servos), "limp"
