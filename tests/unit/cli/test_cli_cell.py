"""``so101 cell``: its questions and its output."""

import json
import re

from click.testing import CliRunner

from so101_motion.cli.verbs import main


def test_one_arm_alone_has_nothing_to_find_out(tmp_path):
    path = tmp_path / "cell.json"
    path.write_text(json.dumps({"arms": [{"name": "left"}]}))
    result = CliRunner().invoke(main, ["cell", "calibrate", str(path)])
    assert result.exit_code == 2
    assert "names one arm" in result.output


def test_touches_that_are_all_the_same_are_refused_and_the_file_stays(tmp_path):
    path = tmp_path / "cell.json"
    content = json.dumps(
        {"arms": [{"name": "left"}, {"name": "right", "position_mm": [350, 0, 0]}]}
    )
    path.write_text(content)
    asked = ["cell", "calibrate", str(path), "--touches", "5", "--yes"]
    result = CliRunner().invoke(main, asked, input="\n" * 5)
    assert result.exit_code != 0
    assert "touch 5 of 5" in result.output
    assert path.read_text() == content
    alone = CliRunner().invoke(main, asked, input="")
    assert "no terminal to press Enter on" in alone.output


def test_arms_are_moved_together(tmp_path):
    path = tmp_path / "cell.json"
    far = {"name": "right", "position_mm": [900, 0, 0], "rpy_deg": [0, 0, 180]}
    path.write_text(json.dumps({"arms": [{"name": "left"}, far]}))
    asked = ["cell", "move", str(path), "--yes", "--json"]
    goals = ["--joints", "left", "3,0,0,0,0", "--joints", "right", "0,0,0,3,0"]
    result = CliRunner().invoke(main, [*asked, *goals])
    assert result.exit_code == 0, result.output
    reached = json.loads(result.stdout)["joints_deg"]
    assert reached == {"left": [3, 0, 0, 0, 0], "right": [0, 0, 0, 3, 0]}
    refused = CliRunner().invoke(main, [*asked, "--joints", "middle", "3,0,0,0,0"])
    assert "left, right" in refused.output
    assert CliRunner().invoke(main, asked).exit_code == 2


def test_an_arm_that_waits_for_another_says_so_before_anything_moves(tmp_path):
    path = tmp_path / "cell.json"
    right = {"name": "right", "position_mm": [350, 0, 0], "rpy_deg": [0, 0, 180]}
    path.write_text(json.dumps({"arms": [{"name": "left"}, right]}))
    goals = ["--joints", "left", "-60,-30,50,20,0", "--joints", "right", "-50,20,0,20,0"]
    result = CliRunner().invoke(main, ["cell", "move", str(path), *goals], input="n\n")
    assert "nothing moved" in result.output
    assert re.search(r"^  (left waits .* for right|right waits .* for left)$", result.output, re.M)


def test_a_handover_needs_a_thing_in_the_hand(tmp_path):
    path = tmp_path / "cell.json"
    right = {"name": "right", "position_mm": [350, 0, 0], "rpy_deg": [0, 0, 180]}
    ball = {"name": "ball", "sphere_radius_mm": 12, "position_mm": [0, 0, 100]}
    asked = ["cell", "handover", str(path), "left", "right", "--yes"]
    path.write_text(json.dumps({"arms": [{"name": "left"}, right]}))
    assert "left holds: nothing" in CliRunner().invoke(main, asked).output
    path.write_text(json.dumps({"arms": [{"name": "left", "attached": [ball]}, right]}))
    result = CliRunner().invoke(main, asked)
    assert result.exit_code != 0
    assert "'ball' is too small" in result.output


def test_a_stick_is_passed_from_hand_to_hand(tmp_path):
    path = tmp_path / "cell.json"
    right = {"name": "right", "position_mm": [350, 0, 0], "rpy_deg": [0, 0, 180]}
    stick = {"name": "stick", "box_mm": [20, 20, 160], "position_mm": [0, 0, 150], "mass_kg": 0.04}
    path.write_text(json.dumps({"arms": [{"name": "left", "attached": [stick]}, right]}))
    asked = ["cell", "handover", str(path), "left", "right", "--yes", "--json"]
    result = CliRunner().invoke(main, asked)
    assert result.exit_code == 0, result.output
    assert "stick from left to right: " in result.stderr
    assert "right holds stick now" in result.stderr
    told = json.loads(result.stdout)
    assert told["duration_s"] > 1.0
    assert (told["taken"]["name"], told["taken"]["mass_kg"]) == ("stick", 0.04)
    assert told["taken"]["position_mm"] != stick["position_mm"]


def test_a_program_of_several_arms_is_run(tmp_path):
    cell, program = tmp_path / "cell.json", tmp_path / "wave.json"
    far = {"name": "right", "position_mm": [900, 0, 0], "rpy_deg": [0, 0, 180]}
    cell.write_text(json.dumps({"arms": [{"name": "left"}, far]}))
    steps = [{"left": {"q_deg": [2, 0, 0, 0, 0]}, "right": {"q_deg": [0, 0, 0, 2, 0]}}]
    program.write_text(json.dumps({"schema": "so101/cell-program/1", "steps": steps}))
    asked = ["cell", "run", str(cell), str(program), "--yes", "--json"]
    result = CliRunner().invoke(main, asked)
    assert result.exit_code == 0, result.output
    reached = json.loads(result.stdout)["joints_deg"]
    assert reached == {"left": [2, 0, 0, 0, 0], "right": [0, 0, 0, 2, 0]}
