"""``so101 cell``: its questions and its output."""

import io
import json
import re

import numpy as np
import pytest
from harness.command_line import refused

from so101_motion.arm.cell import Cell
from so101_motion.arm.motion_handle import Motion
from so101_motion.planning.goals import JointGoal
from so101_motion.rig import cell_rigs
from so101_motion.rig.cell_rigs import open_cell

LEFT = {"name": "left"}
FAR = {"name": "right", "position_mm": [900, 0, 0], "rpy_deg": [0, 0, 180]}
NEAR = {"name": "right", "position_mm": [350, 0, 0], "rpy_deg": [0, 0, 180]}


@pytest.fixture
def cell(tmp_path):
    """Makes a cell file of arms."""

    def made(*arms):
        path = tmp_path / "cell.json"
        path.write_text(json.dumps({"arms": arms}))
        return path

    return made


def test_one_arm_alone_and_touches_that_are_all_the_same_are_refused_and_the_file_stays(
    so101, cell
):
    assert "names one arm" in refused(so101("cell calibrate", cell(LEFT)))
    path = cell(LEFT, NEAR)
    content = path.read_text()
    asked = f"cell calibrate {path} --touches 5 --yes"
    assert "touch 5 of 5" in refused(so101(asked, input="\n" * 5), 6)
    assert path.read_text() == content
    alone = so101(asked, input="")
    assert "no terminal to press Enter on" in alone.output


def test_arms_are_moved_together(so101, told, cell):
    asked = f"cell move {cell(LEFT, FAR)} --yes"
    moved = told(f"{asked} --joints left 3,0,0,0,0 --joints right 0,0,0,3,0")
    assert moved["joints_deg"] == {"left": [3, 0, 0, 0, 0], "right": [0, 0, 0, 3, 0]}
    there = so101(f"cell move {cell(LEFT, FAR)} --joints left 0,0,0,0,0")  # nothing to agree to
    assert "left and right: already there\nleft: [0.0" in there.output
    assert "left, right" in so101(f"{asked} --joints middle 3,0,0,0,0").output
    assert so101(asked).exit_code == 2


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("--camera overhead", "must be an address that begins with http://"),
        ("--leader sim", "need a single arm"),
    ],
)
def test_the_page_of_several_arms_refuses_what_it_cannot_show(so101, cell, options, says):
    result = so101(f"view --cell {cell(LEFT)} {options}")
    assert result.exit_code != 0
    assert says in " ".join(result.output.split())


class AnswersYes(io.RawIOBase):
    """A person at the terminal who says yes, after ``first()``."""

    def __init__(self, first):
        self.first, self.left = first, b"y\n"

    def readable(self):
        return True

    def readinto(self, buffer):
        if self.left:
            self.first()
        count = len(self.left)
        buffer[:count], self.left = self.left, b""
        return count


@pytest.fixture
def opened_cells(monkeypatch):
    """The cells that a command has opened."""
    opened = []

    def noted(file):
        opened.append(open_cell(file))
        return opened[-1]

    monkeypatch.setattr(cell_rigs, "open_cell", noted)
    return opened


def test_the_motion_that_was_agreed_to_runs_or_none(so101, cell, opened_cells):
    asked = f"cell move {cell(LEFT, FAR)} --joints left 3,0,0,0,0 --joints right 0,0,0,3,0"

    def move_one_away():
        right = opened_cells[-1].rigs["right"].arm
        right.move(JointGoal(q=right.state.q_ref + 0.05))

    result = so101(asked, input=io.BufferedReader(AnswersYes(move_one_away)))
    assert result.exit_code != 0
    assert "right: the arm is 2.86 deg away from where this plan starts\n" in result.output
    left = opened_cells[-1].rigs["left"].arm
    np.testing.assert_array_equal(left.state.q_ref, np.zeros(5))
    result = so101(asked, input="y\n")
    assert result.exit_code == 0, result.output
    np.testing.assert_allclose(opened_cells[-1].rigs["left"].arm.state.q_ref[0], np.radians(3.0))


def test_an_arm_that_waits_for_another_says_so_before_anything_moves(so101, cell):
    goals = "--joints left -60,-30,50,20,0 --joints right -50,20,0,20,0"
    result = so101(f"cell move {cell(LEFT, NEAR)} {goals}", input="n\n")
    assert "nothing moved" in result.output
    assert re.search(r"^  (left waits .* for right|right waits .* for left)$", result.output, re.M)


def test_a_handover_needs_a_thing_in_the_hand(so101, cell):
    ball = {"name": "ball", "sphere_radius_mm": 12, "position_mm": [0, 0, 100]}
    asked = f"cell handover {cell(LEFT, NEAR)} left right --yes"
    assert "left holds: nothing" in so101(asked).output
    cell({**LEFT, "attached": [ball]}, NEAR)
    assert "'ball' is too small" in refused(so101(asked), 5)


def test_a_stick_is_passed_from_hand_to_hand(so101, cell):
    stick = {"name": "stick", "box_mm": [20, 20, 160], "position_mm": [0, 0, 150], "mass_kg": 0.04}
    path = cell({**LEFT, "attached": [stick]}, NEAR)
    result = so101(f"cell handover {path} left right --yes --json")
    assert result.exit_code == 0, result.output
    assert "stick from left to right: " in result.stderr
    assert "right holds stick now" in result.stderr
    told = json.loads(result.stdout)
    assert told["duration_s"] > 1.0
    assert (told["taken"]["name"], told["taken"]["mass_kg"]) == ("stick", 0.04)
    assert told["taken"]["position_mm"] != stick["position_mm"]


def test_a_program_of_several_arms_is_run(told, cell, tmp_path):
    program = tmp_path / "wave.json"
    steps = [{"left": {"q_deg": [2, 0, 0, 0, 0]}, "right": {"q_deg": [0, 0, 0, 2, 0]}}]
    program.write_text(json.dumps({"schema": "so101/cell-program/1", "steps": steps}))
    done = told(f"cell run {cell(LEFT, FAR)} {program} --yes")
    assert done["joints_deg"] == {"left": [2, 0, 0, 0, 0], "right": [0, 0, 0, 2, 0]}


@pytest.mark.parametrize("flags", ["", "--json"])
def test_ctrl_c_stops_all_arms_and_says_so(so101, cell, monkeypatch, flags):
    stopped = []
    own = Cell.stop

    def interrupted(motion, timeout=None):
        raise KeyboardInterrupt

    def stop(cell):
        own(cell)
        stopped.append([member.arm.state.arm_moving for member in cell.members.values()])

    monkeypatch.setattr(Motion, "result", interrupted)
    monkeypatch.setattr(Cell, "stop", stop)
    result = so101(f"cell move {cell(LEFT, FAR)} --joints left 60,0,0,0,0 --yes {flags}")
    assert result.exit_code == 130
    assert 'the arm "left" holds; the arm "right" holds' in result.stderr
    assert stopped == [[False, False]]
    if flags:
        assert json.loads(result.stdout)["kind"] == "interrupted"
