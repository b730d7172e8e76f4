"""The parts of the guided verbs, without an arm and without a person."""

import io
import json
import os
import pty
import threading
import time
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from so101_motion.calib.procedure.sampler import TREMBLE, Stillness
from so101_motion.cli.operation_terminal import bar_of, drawn
from so101_motion.cli.terminal import ENTER, Quit, Terminal
from so101_motion.common.operation import Row, View

# Holding still


def test_joints_are_still_once_nobody_has_moved_for_a_while_and_all_are_seen():
    stillness = Stillness()
    held = {"elbow_flex": 2000, "gripper": 1500}
    assert stillness.feed(10.0, held) == 0.0
    assert stillness.feed(11.0, {**held, "gripper": 1500 + TREMBLE}) == 1.0
    assert stillness.feed(11.2, {**held, "gripper": 1501 + TREMBLE}) == 0.0
    assert stillness.feed(12.7, {**held, "gripper": 1501 + TREMBLE}) >= 1.5
    stillness = Stillness()
    stillness.feed(0.0, {"elbow_flex": 2000})
    assert stillness.feed(5.0, {"elbow_flex": None}) == 0.0
    assert stillness.feed(6.0, {"elbow_flex": 2000}) == 0.0
    assert stillness.feed(7.0, {"elbow_flex": 2000}) == 1.0


@given(st.lists(st.integers(0, 4095), min_size=1, max_size=30))
def test_an_arm_that_was_held_still_has_not_left_its_place(places):
    stillness = Stillness()
    for step, place in enumerate(places):
        seconds = stillness.feed(float(step), {"elbow_flex": place})
        held = places[step - round(seconds) : step + 1]
        assert max(held) - min(held) <= 2 * TREMBLE


# Rows


def test_a_bar_shows_the_travel_and_where_the_joint_is():
    drawn = bar_of(Row(label="", bar=(0.25, 0.75), at=0.5)).plain
    assert drawn == "·" * 8 + "█" * 8 + "●" + "█" * 7 + "·" * 8
    assert "●" not in bar_of(Row(label="", bar=(0.0, 1.0))).plain


def test_tables_name_every_row_and_what_is_to_do():
    console = Console(width=100, file=io.StringIO())
    bar = Row(label="elbow_flex", cells=("3 of 9",), bar=(0.1, 0.2), text="move it on")
    console.print(drawn(View(state="", rows=(bar,))))
    console.print(drawn(View(state="", columns=("now",), rows=(Row(label="jaw", cells=("?",)),))))
    text = console.file.getvalue()
    for words in ("elbow_flex", "move it on", "3 of 9", "jaw", "now"):
        assert words in text


# A terminal


def test_without_a_person_nothing_is_asked_and_lines_are_reported_once(capsys, tmp_path):
    with open(tmp_path / "events", "w") as events, Terminal(events=events) as terminal:
        terminal.say("hello", step="begin")
        terminal.say("hello")
        terminal.mention("there", joint="gripper")
        terminal.show("a picture")
        assert not terminal.is_manned
        assert terminal.run(lambda: 42, lambda: "") == 42
        with pytest.raises(ZeroDivisionError):
            terminal.run(lambda: 1 / 0, lambda: "")
    assert capsys.readouterr().err == "hello\nthere\n"
    told = [json.loads(line) for line in (tmp_path / "events").read_text().splitlines()]
    assert [(event["says"], event.get("step")) for event in told] == [
        ("hello", "begin"),
        ("there", None),
    ]


@contextmanager
def keyboard():
    """A terminal for standard input and error; what is written to it is pressed."""
    person, program = pty.openpty()
    with (
        os.fdopen(os.dup(program), "r", encoding="utf-8") as stream,
        os.fdopen(program, "w", encoding="utf-8") as output,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr("sys.stdin", stream)
        patch.setattr("sys.stderr", output)
        patch.setenv("TERM", "xterm")
        yield person
    os.close(person)


def test_a_key_is_heard_while_something_goes_on_and_q_lets_it_end_first():
    ended, told = [], threading.Event()

    def waits_for_the_key():
        while terminal.pressed != "s":
            time.sleep(0.001)
        ended.append(True)

    def waits_for_the_person_to_be_told():
        assert told.wait(60.0)
        ended.append(True)

    with keyboard() as person, Terminal() as terminal:
        assert terminal.is_manned
        os.write(person, b"s")
        terminal.run(waits_for_the_key, lambda: "picture")
        terminal.say = lambda _: told.set()  # that the step is finished first
        os.write(person, b"q")
        with pytest.raises(Quit):
            terminal.run(waits_for_the_person_to_be_told, lambda: "picture")
        assert ended == [True, True]
        os.write(person, b"\n")
        assert terminal.key(1.0) == ENTER
        os.write(person, b"R")
        assert terminal.key(1.0) == "r"
