"""The demo, the emulator, a plan, a move and a move test: what they print, write and refuse."""

import contextlib
import json
import re
import signal
import socket
import subprocess
import sys
import time

import pytest
from harness.command_line import refused

import so101_motion as library
from so101_motion.arm.gripper import Gripper
from so101_motion.calib.record import servo_file
from so101_motion.calib.record.servo_file import ServoRecord
from so101_motion.drivers.emulator import run
from so101_motion.drivers.servo_types import STS3215_7V4, ServoFigures
from so101_motion.rig import simulated_rig

SO101 = [sys.executable, "-m", "so101_motion.cli"]


def test_the_demo_in_text_shows_a_plan_and_arrives(so101):
    result = so101("demo --text")
    assert result.exit_code == 0, result.output
    for word in ("shoulder_pan", "wrist_roll", "deg/s", "setpoints", "arrived", "simulated"):
        assert word in result.output


def test_a_busy_port_is_named_with_something_to_try(so101):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        result = so101("demo --web-port", port)
    assert result.exit_code == 2
    assert f"127.0.0.1:{port}" in result.output
    assert "choose another port (--web-port), for example" in result.output


def test_where_no_port_was_asked_for_it_says_which_one_is_taken_instead():
    command = [*SO101, "demo", "--no-browser"]
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # closed a moment ago is free
        for _ in range(300):  # another program may have it for a while, or for ever
            with contextlib.suppress(OSError):
                taken.bind(("127.0.0.1", 8080))
                taken.listen()
                break
            time.sleep(0.1)
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as demo:
            link = demo.stdout.readline().decode()
            demo.terminate()
            said = demo.stderr.read().decode()
            assert demo.wait(60.0) == 130
        port = int(re.search(r":(\d+)/", link)[1])
        assert 8080 < port < 8100
        assert f"port 8080 is taken, so the page is on port {port}" in said


def test_ctrl_c_ends_it_without_a_traceback_while_it_is_being_imported():
    program = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell's jobs ignore it
        "class Finder:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'so101_motion.cli.view':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "from so101_motion.cli import main\n"
        "main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, "--version"], capture_output=True, timeout=60.0
    )
    assert (done.returncode, done.stdout, done.stderr) == (
        130,
        b"",
        b"ended by Ctrl-C; nothing moved\n",
    )


@pytest.mark.parametrize(
    ("option", "says"), [("--ids 9", "places 1 to 6"), ("--fault nonsense", "must be one of dead")]
)
def test_an_emulation_that_cannot_be_is_refused_in_a_sentence(so101, option, says):
    assert says in refused(so101(f"emulate {option}"))


def test_a_twin_has_the_type_of_its_supply_and_the_servos_of_the_file(so101, tmp_path, monkeypatch):
    stiff, emulated = {"wrist_roll": ServoFigures(torque=1.0, friction=3.0)}, []
    found = ServoRecord(at="2026-03-05", volts=7.4, servos=stiff)
    file = servo_file.save(tmp_path / "my_arm.json", found)
    monkeypatch.setattr(run, "run_emulator", lambda options, **_: emulated.append(options))
    assert so101(f"emulate --volts 7.4 --like {file}").exit_code == 0
    assert (emulated[0].kind, emulated[0].figures) == (STS3215_7V4, stiff)


def test_the_emulator_prints_its_port_and_ends_on_sigterm(tmp_path):
    link = tmp_path / "arm"
    command = [*SO101, "emulate", "--link", str(link)]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as emulator:
        assert emulator.stdout.readline().decode().strip() == str(link)
        assert link.is_symlink()
        emulator.terminate()
        assert emulator.wait(60.0) == 130
    assert not link.exists()


def test_a_plan_is_shown_and_saved_as_a_table_and_as_a_film_and_nothing_moves(so101, tmp_path):
    table, film = tmp_path / "move.csv", tmp_path / "move.html"
    result = so101("plan --sim --xyz 250,120,150 --out", table, "--html", film)
    assert result.exit_code == 0, result.output
    assert "shoulder_pan" in result.output
    header, *rows = table.read_text().splitlines()
    assert header.startswith("time_s,shoulder_pan_deg,")
    assert len(rows) > 10
    page = film.read_text()
    assert "Simulated arm" in page
    assert "Peak speed" in page


def test_a_plan_from_anywhere_and_what_the_jaw_holds_are_objects_for_programs(told):
    content = told("plan --sim --joints 0,-45,45,60,0 --from 10,-40,40,60,0")
    assert content["schema"] == "so101/plan/1"
    assert content["q_start_deg"] == pytest.approx([10, -40, 40, 60, 0])
    assert content["q_goal_deg"] == pytest.approx([0, -45, 45, 60, 0])
    assert content["duration_s"] > 0.2
    assert told("gripper open --sim --yes")["jaw_percent"] == 100
    assert told("gripper grab --sim --yes")["holds"] is False


def test_a_grab_that_holds_nothing_fails_where_a_jaw_can_tell(so101, told, monkeypatch):
    away = library.SE3.from_translation((0.0, 0.3, 0.01))
    ball = library.Obstacle(
        name="ball", shape=library.Sphere(radius=0.01), T_base_obstacle=away, mass=0.03
    )
    scene = library.Scene(obstacles=(ball,))
    monkeypatch.setattr(simulated_rig, "checked_scene", lambda _: scene)
    assert so101("gripper grab --sim --yes").exit_code == 6
    assert told("gripper close --sim --yes")["holds"] is False
    assert "; it holds nothing" in so101("gripper close --sim --yes").output
    assert so101("gripper open --sim --yes").output == "the jaw is 100 % open\n"
    monkeypatch.setattr(Gripper, "is_silent", True)
    assert "what it holds is not known" in refused(so101("gripper grab --sim --yes"), 4)


def test_obstacles_of_a_scene_are_avoided_or_named(so101, tmp_path):
    scene = tmp_path / "scene.json"
    mug = {"name": "mug", "box_mm": [80] * 3, "position_mm": [250, 120, 150]}
    scene.write_text(json.dumps({"obstacles": [mug]}))
    assert "mug" in refused(so101("plan --sim --xyz 250,120,150 --scene", scene), 5)


def test_each_group_shows_an_example_of_each_of_its_verbs(so101):
    for group in ("guide", "cell", "calibration", "dataset", "sweep", "viam"):
        assert f"Examples:\n  so101 {group} " in so101(f"{group} --help").output
    assert "\n  so101 cell run class.json wave.json --all\n" in so101("cell --help").output


def test_an_arm_that_is_already_there_says_so_and_is_not_asked(so101):
    for verb in ("home --sim", "move --sim --pose home", "move --sim --joints 0,0,0.05,0,0"):
        assert so101(verb).output.startswith("already there: tool at (293.2, "), verb
    assert so101("plan --sim --pose home").output == "the arm is already there: no joint moves\n"
    asked = so101("move --sim --pose home --at-end park", input="n\n")  # this moves it
    assert "Move the simulated arm" in asked.output


@pytest.mark.parametrize(
    ("verb", "shows", "question"),
    [
        ("move --sim --joints 5,0,0,0,0", "setpoints", "Move the simulated arm for"),
        ("gripper open --sim", "", "Open the jaw of the simulated arm?"),
        ("move-test --sim", "6° back and forth", "Is everything out of the way?"),
    ],
)
def test_nothing_moves_before_somebody_agrees(so101, verb, shows, question):
    result = so101(verb, input="n\n")
    assert result.exit_code == 7
    for words in (shows, question, "nothing moved"):
        assert words in result.output
    assert "arrived" not in result.output
    assert "0 %  shoulder_pan" not in result.output


def test_a_move_that_nobody_can_agree_to_says_so_to_people_and_to_programs(so101):
    result = so101("move --sim --joints 5,0,0,0,0 --json")
    assert result.exit_code == 2
    assert json.loads(result.stdout)["kind"] == "usage"
    assert "--yes" in result.stderr


def test_ctrl_c_stops_the_arm_and_what_was_measured_is_reported():
    process = subprocess.Popen(
        [*SO101, "move-test", "--sim", "--yes"],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while "0 %" not in process.stderr.readline():
        pass
    process.send_signal(signal.SIGINT)
    told, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert told.startswith("The test was not finished: ")
    assert said == "ended by Ctrl-C; the simulated arm holds\n"


@pytest.mark.parametrize(
    ("options", "code", "says"),
    [
        ("--sim", 2, "give one goal"),
        ("--sim --xyz 0.25,0.1,0.1", 2, "did you mean 250,100,100"),
        ("--sim --xyz 1,2,nan", 2, "3 numbers"),
        ("--sim --xyz near", 2, "X,Y,Z"),
        ("--sim --pose home --line", 2, "belong to --xyz"),
        ("--sim --pose home --frame jaw_tip", 2, "belong to --xyz"),
        ("--sim --xyz 200,0,100 --approach 0,0,0", 2, "direction"),
        ("--sim --xyz 900,0,100", 5, "reach"),
        ("--sim --joints 0,0,120,0,0", 5, "elbow_flex"),
        ("--sim --xyz 1e308,0,0", 2, "from -5000 to 5000"),
        ("--sim --pose home --from 1e9,0,0,0,0", 2, "from -360 to 360"),
        ("--sim --xyz 200,0,100 --approach 1e-320,0,0", 2, "direction"),
        ("--sim --pose home --calibration arm.json", 2, "works only with --port"),
        ("--port /tmp --pose home", 3, "not a serial port"),
    ],
)
def test_a_mistake_is_a_sentence_and_an_exit_code(so101, options, code, says):
    assert says in refused(so101(f"plan {options}"), code)


@pytest.mark.parametrize(
    ("line", "same"), [("help", "--help"), ("help move", "move --help"), ("-v", "--version")]
)
def test_what_people_type_for_help_and_the_version_works(so101, line, same):
    assert so101(line).stdout == so101(same).stdout != ""


def test_a_port_without_a_name_is_refused(so101):
    assert "port's name is empty" in refused(so101("plan --pose home --port", ""))
